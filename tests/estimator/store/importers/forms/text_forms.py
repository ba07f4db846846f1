"""Forms of text: 24 of bug reports, and other separators, signs, comments, cells and lines that are no rows."""

from __future__ import annotations

import json

import numpy as np

from tests.estimator.store.importers.forms import written as w
from tests.estimator.store.importers.forms.written import (
    HEAD,
    HEADER,
    LINES,
    PLACES,
    REST,
    TABLE,
    Form,
    lines,
    text,
)

T = w.T
BLANKS = [line.replace(",", " ") for line in LINES]
MICRO = f"{PLACES},Bx [µT],By [µT],Bz [µT]"
BACK = np.concatenate((T[:40], T[:20]))
ODD = np.concatenate((T[:40], T[:20] - 0.25))
AFTER = np.concatenate((T[:40], 20.0 + T[:20]))
UNCLEAR = np.full((9, 8), 1.125) + np.arange(9)[:, None]
ENDS = [line.rpartition(",")[0] for line in LINES]


def thousands(signs: str, separator: str = ";") -> str:
    """With these signs between thousands and before decimals."""
    return text(separator=separator, cell=lambda value: f"{value:,.1f}".translate(str.maketrans(",.", signs)))


OF_REPORTS = [
    Form("a_utf16.csv", text(end="\r\n").encode("utf-16")),
    Form("b_latin1.csv", text(MICRO).encode("latin-1")),
    Form("c_comments.csv", lines("# Lake Shore F71 log", "# operator: -", *LINES)),
    Form("d_blanks.txt", lines(*BLANKS)),
    Form(
        "e_half_first_line.csv",
        lines(LINES[0], "," + LINES[1].split(",", 3)[3], *LINES[2:]),
        False,
        TABLE[1:],
        tells="a row must have 8 cells like the header; received 6",
    ),
    Form(
        "f_two_lines_run_together.csv",
        lines(*LINES[:21], LINES[21][:14] + LINES[22], *LINES[23:]),
        False,
        np.delete(TABLE, [20, 21], axis=0),
        tells="line 22",
    ),
    Form("g_header_again.csv", lines(*LINES[:31], LINES[0], *LINES[31:])),
    Form("h_decimal_commas_quoted.csv", text(decimal=",")),
    Form(
        "i_clock.csv",
        w.columns(f"Time,{REST}", w.clocks("%H:%M:%S", 2 * T), *TABLE.T[1:]),
        expected=w.with_times(43200.0 + 2 * T),
    ),
    Form("j_milliseconds.csv", text(f"t_ms,{REST}", w.with_times(1e3 * T))),
    Form("k_milligauss.csv", text(f"{PLACES},Bx_mG,By_mG,Bz_mG", TABLE * [1, 1, 1, 1, 1, 10, 10, 10])),
    Form(
        "l_no_reading.csv",
        lines(*LINES[:10], ENDS[10] + ",OVLD", *LINES[11:15], ENDS[15] + ",nan", *LINES[16:]),
        expected=w.with_nan((9, 7), (14, 7)),
        tells="2 cells of fields count as not measured: OVLD in line 11, nan in line 16.",
    ),
    Form(
        "m_clock_set_back.csv",
        text(rows=w.with_times(BACK)),
        False,
        w.with_times(AFTER),
        tells="--clock continue",
    ),
    Form(
        "n_clock_set_back_unseen.csv",
        text(rows=w.with_times(ODD)),
        expected=w.with_times(ODD),
        tells="Time jumps back in line 42",
    ),
    Form("o_whole_seconds.csv", text(rows=w.with_times(np.floor(T))), False, tells="--clock spread"),
    Form("p_old_mac.csv", text(end="\r")),
    Form("q_nul_at_the_end.csv", text() + "\0" * 200),
    Form("r_thousands.csv", thousands(",.", separator=",")),
    Form("s_semicolons.csv", text(HEADER, separator=";", decimal=",", end="\r\n")),
    Form("t_units_row.csv", text("t,coil1_current,stage_x,stage_y,stage_z,Bx,By,Bz\ns,A,mm,mm,mm,uT,uT,uT")),
    Form("u_broken_workbook.xlsx", w.BROKEN_WORKBOOK, False, answer=w.PLAIN, tells="export it as CSV"),
    Form(
        "v_stray_quote.csv",
        lines(*LINES[:30], '"' + LINES[30], *LINES[31:]),
        False,
        np.delete(TABLE, 29, axis=0),
        tells="a quote must enclose a whole cell; cell 1",
    ),
    Form(
        "w_unit_that_nobody_knows.csv",
        text(f"{PLACES},Bx_kilo,By_uT,Bz_uT"),
        False,
        units={"Bx": "uT"},
        tells="'Bx_kilo'",
    ),
    Form(
        "x_tesla_without_unit.csv", text(f"{PLACES},Bx,By,Bz"), False, units=w.UNITS, tells="must have a unit"
    ),
]
OF_TEXT = [
    Form("utf16_without_mark.csv", text().encode("utf-16-le")),
    Form("utf16_big.csv", b"\xfe\xff" + text(MICRO).encode("utf-16-be")),
    Form("utf8_mark_and_semicolons.csv", "\ufeff" + text(MICRO.split(","), separator=";")),
    Form("shift_jis_preamble.csv", ("磁場測定の記録\n" + text(w.LAB, w.IN_G)).encode("shift_jis")),
    Form("tabs.txt", text(HEADER, separator="\t")),
    Form("tabs_and_decimal_commas.txt", text(HEADER, separator="\t", decimal=",")),
    Form("bars.txt", text(HEADER, separator="|")),
    Form("aligned.txt", "\n".join("".join(f"{cell:>18}" for cell in line.split(",")) for line in LINES)),
    Form(
        "blanks_in_names.txt",
        lines("Time [s]  I coil [A]  X [mm]  Y [mm]  Z [mm]  B x [uT]  B y [uT]  B z [uT]", *BLANKS[1:]),
    ),
    Form("preamble.csv", lines("Gaussmeter GM-3", "Serial: 12, 345", "", *LINES)),
    Form("excel_sep_line.csv", "sep=;\n" + text(HEADER, separator=";")),
    Form("savetxt.txt", lines("# " + BLANKS[0], *BLANKS[1:])),
    Form("matlab_comment.csv", text(f"% {HEAD}")),
    Form(
        "dashes_below_the_header.txt",
        text("\t".join(HEADER) + "\n" + "\t".join(["------"] * 8), separator="\t"),
    ),
    Form("separator_at_the_end.csv", lines(*(line.replace(",", ";") + ";" for line in LINES))),
    *(
        Form(
            f"{name}.csv",
            w.columns((*HEADER, heading), *TABLE.T, [word * (row == 40) for row in range(60)], separator=";"),
            tells=f"Left out: {heading}.",
        )
        for name, heading, word in (
            ("comments_in_few_rows", "Remarks", "lamp on"),
            ("remarks_in_few_rows_under_another_word", "Bemerkung", "Licht an"),
        )
    ),
    Form(
        "comments_without_separators.csv",
        lines(f"{HEAD},Note", *(line + ",paused" * (row == 5) for row, line in enumerate(LINES[1:]))),
        tells="Left out: Note.",
    ),
    Form("empty_columns.csv", lines(*(line + ",,," for line in LINES))),
    Form("blank_lines.csv", lines(*(part for line in LINES for part in (line, "")))),
    Form("comments_between.csv", lines(*LINES[:20], "# paused", *LINES[20:])),
    Form("torn_at_the_end.csv", text()[:-12], False, TABLE[:-1], tells="--skip-bad-lines"),
    Form("fortran.txt", text(HEADER, separator=" ", cell=lambda value: f"{value:.9E}".replace("E", "D"))),
    Form("apostrophes.csv", thousands("'.")),
    Form("points_as_thousands.csv", thousands(".,")),
    Form("blanks_as_thousands.csv", thousands("\u202f,")),
    Form("long_minus.csv", text(cell=lambda value: w.shown(value).replace("-", "\u2212"))),
    Form(
        "unclear_commas.csv",
        text(HEADER, UNCLEAR, ";", cell=lambda value: f"{value:.3f}".replace(".", ",")),
        False,
        UNCLEAR,
        tells="--decimal comma",
    ),
    Form(
        "overload_of_scpi.csv",
        lines(*LINES[:10], ENDS[10] + ",9.9E37", *LINES[11:]),
        expected=w.with_nan((9, 7)),
    ),
    Form(
        "a_sensor_that_was_off.csv",
        lines(*LINES[:10], ",".join(LINES[10].split(",")[:5]) + ",,,", *LINES[11:]),
        expected=np.delete(TABLE, 9, axis=0),
        tells="1 row left out (line 11)",
    ),
    Form("no_header.csv", lines(*LINES[1:]), False, answer=w.PLAIN, tells="put a line above that names each"),
]
WORDS_FOR_NOTHING = {3: "#N/A", 5: "OL", 7: "--", 9: "overload", 11: "Inf"}
OF_CELLS = [
    Form("microtesla_called_tesla.csv", text(f"{PLACES},Bx_T,By_T,Bz_T"), False, tells="fields look like uT"),
    *(
        Form(name, w.columns(HEAD, *TABLE.T[:5], *([w.shown(b) + doubt for b in c] for c in TABLE.T[5:])))
        for name, doubt in (("uncertainties.csv", " ± 1.0"), ("digits_in_doubt.csv", "(10)"))
    ),
    Form(
        "words_for_nothing.csv",
        w.columns(HEAD, *TABLE.T[:7], [WORDS_FOR_NOTHING.get(i, b) for i, b in enumerate(w.BZ)]),
        expected=w.with_nan(*((row, 7) for row in WORDS_FOR_NOTHING)),
        tells="5 cells of fields count as not measured: #N/A in line 5, OL in line 7, -- in line 9 and 2 more.",
    ),
    Form("durations.csv", w.columns(f"Elapsed,{REST}", [f"0:00:{t:04.1f}" for t in T], *TABLE.T[1:])),
    Form(
        "units_in_cells.csv",
        w.columns(
            "t,I,x,y,z,Bx,By,Bz",
            *([f"{w.shown(v)} {unit}" for v in c] for c, unit in zip(TABLE.T, w.UNITS.values(), strict=True)),
        ),
        False,
        answer=w.PLAIN,
        tells="write units into the header, such as t [s], and only numbers below",
    ),
    Form(
        "vectors_in_cells.csv",
        lines(
            "t (s);I (A);position (mm);B (uT)",
            *(
                f"{t};{i};({x}, {y}, {z});({a}, {b}, {c})"
                for t, i, x, y, z, a, b, c in (line.split(",") for line in LINES[1:])
            ),
        ),
        False,
        answer=w.PLAIN,
        tells="write each component into a column of its own",
    ),
    Form(
        "commas_for_all.csv",
        lines(HEAD, *(",".join(f"{value:.2f}".replace(".", ",") for value in row) for row in TABLE)),
        False,
        answer=text(HEADER, separator=";", decimal=","),
        tells="export it with semicolons between cells",
    ),
    Form(
        "markdown.md",
        lines(*(f"| {line.replace(',', ' | ')} |" for line in LINES)).replace(
            "\n", "\n|" + "---|" * 8 + "\n", 1
        ),
    ),
    Form(
        "records.json",
        json.dumps({"rig": "bench", "readings": [dict(zip(HEADER, row, strict=True)) for row in TABLE]}),
    ),
    Form(
        "records_a_line.jsonl",
        lines(
            *(
                json.dumps({"t_s": t, "current": {"A": current}, "position_mm": row[:3], "B_uT": row[3:]})
                for t, current, *row in TABLE
            )
        ),
    ),
    Form("lists.json", json.dumps({name: list(c) for name, c in zip(HEADER, TABLE.T, strict=True)})),
]
