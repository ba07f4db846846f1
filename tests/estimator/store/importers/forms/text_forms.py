"""Forms of text: 24 of bug reports, and other separators, signs, comments and lines that are no rows."""

from __future__ import annotations

import numpy as np

from tests.estimator.store.importers.forms.pieces import (
    AFTER,
    BACK,
    IN_G,
    LAB,
    LINES,
    MICRO,
    NOON,
    ODD,
    PLAIN,
    UNITS,
    T,
    clock,
    lines,
    with_nan,
    without_first_cell,
)
from tests.estimator.store.importers.forms.written import (
    BROKEN_WORKBOOK,
    HEADER,
    TABLE,
    Form,
    columns,
    scaled,
    shown,
    text,
    with_times,
)

OF_REPORTS = [
    Form("a_utf16.csv", text(end="\r\n").encode("utf-16")),
    Form("b_latin1.csv", text(MICRO).encode("latin-1")),
    Form("c_comments.csv", lines("# Lake Shore F71 log", "# operator: -", *LINES)),
    Form("d_blanks.txt", text(separator=" ").encode()),
    Form(
        "e_half_first_line.csv",
        lines(LINES[0], without_first_cell(LINES[1], 3), *LINES[2:]),
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
    Form("h_decimal_commas_quoted.csv", text(decimal=",").encode()),
    Form(
        "i_clock.csv",
        columns(["Time", *HEADER[1:]], [clock(t, NOON, "%H:%M:%S") for t in 2 * T], *TABLE.T[1:]).encode(),
        expected=with_times(43200.0 + 2 * T),
    ),
    Form("j_milliseconds.csv", text(["t_ms", *HEADER[1:]], scaled([1e-3] + [1] * 7)).encode()),
    Form(
        "k_milligauss.csv",
        text([*HEADER[:5], "Bx_mG", "By_mG", "Bz_mG"], scaled([1] * 5 + [0.1] * 3)).encode(),
    ),
    Form(
        "l_no_reading.csv",
        lines(
            *LINES[:10],
            LINES[10].rpartition(",")[0] + ",OVLD",
            *LINES[11:15],
            LINES[15].rpartition(",")[0] + ",nan",
            *LINES[16:],
        ),
        expected=with_nan((9, 7), (14, 7)),
        tells="2 cells of fields count as not measured: OVLD in line 11, nan in line 16.",
    ),
    Form(
        "m_clock_set_back.csv",
        text(rows=with_times(BACK)).encode(),
        False,
        with_times(AFTER),
        tells="--clock continue",
    ),
    Form(
        "n_clock_set_back_unseen.csv",
        text(rows=with_times(ODD)).encode(),
        expected=with_times(ODD),
        tells="Time jumps back in line 42",
    ),
    Form("o_whole_seconds.csv", text(rows=with_times(np.floor(T))).encode(), False, tells="--clock spread"),
    Form("p_old_mac.csv", text(end="\r").encode()),
    Form("q_nul_at_the_end.csv", text().encode() + b"\0" * 200),
    Form(
        "r_thousands.csv",
        text(cell=lambda value: f"{value:,.1f}").encode(),
    ),
    Form("s_semicolons.csv", text(separator=";", decimal=",", end="\r\n").encode()),
    Form(
        "t_units_row.csv",
        lines("t,coil1_current,stage_x,stage_y,stage_z,Bx,By,Bz", "s,A,mm,mm,mm,uT,uT,uT", *LINES[1:]),
    ),
    Form("u_broken_workbook.xlsx", BROKEN_WORKBOOK, False, answer=PLAIN.encode(), tells="export it as CSV"),
    Form(
        "v_stray_quote.csv",
        lines(*LINES[:30], '"' + LINES[30], *LINES[31:]),
        False,
        np.delete(TABLE, 29, axis=0),
        tells="a quote must enclose a whole cell; cell 1",
    ),
    Form(
        "w_unit_that_nobody_knows.csv",
        text([*HEADER[:5], "Bx_kilo", "By_uT", "Bz_uT"]).encode(),
        False,
        units={"Bx": "uT"},
        tells="'Bx_kilo'",
    ),
    Form(
        "x_tesla_without_unit.csv",
        text([*HEADER[:5], "Bx", "By", "Bz"]).encode(),
        False,
        units=UNITS,
        tells="must have a unit",
    ),
]
OF_TEXT = [
    Form("utf16_without_mark.csv", text().encode("utf-16-le")),
    Form("utf16_big.csv", b"\xfe\xff" + text(MICRO).encode("utf-16-be")),
    Form("utf8_mark_and_semicolons.csv", ("\ufeff" + text(MICRO, separator=";")).encode()),
    Form("shift_jis_preamble.csv", ("磁場測定の記録\n" + text(LAB, scaled(IN_G))).encode("shift_jis")),
    Form("tabs.txt", text(separator="\t").encode()),
    Form("tabs_and_decimal_commas.txt", text(separator="\t", decimal=",").encode()),
    Form("bars.txt", text(separator="|").encode()),
    Form(
        "aligned.txt",
        "\n".join("".join(f"{cell:>18}" for cell in line.split(",")) for line in LINES).encode(),
    ),
    Form(
        "blanks_in_names.txt",
        lines(
            "Time [s]  I coil [A]  X [mm]  Y [mm]  Z [mm]  B x [uT]  B y [uT]  B z [uT]",
            *(line.replace(",", " ") for line in LINES[1:]),
        ),
    ),
    Form("preamble.csv", lines("Gaussmeter GM-3", "Serial: 12, 345", "", *LINES)),
    Form("excel_sep_line.csv", ("sep=;\n" + text(separator=";")).encode()),
    Form(
        "savetxt.txt",
        lines("# " + LINES[0].replace(",", " "), *(line.replace(",", " ") for line in LINES[1:])),
    ),
    Form("matlab_comment.csv", lines("% " + LINES[0], *LINES[1:])),
    Form(
        "dashes_below_the_header.txt",
        lines(
            LINES[0].replace(",", "\t"),
            "\t".join(["------"] * 8),
            *(line.replace(",", "\t") for line in LINES[1:]),
        ),
    ),
    Form("separator_at_the_end.csv", lines(*(line + ";" for line in text(separator=";").splitlines()))),
    Form(
        "comments_in_few_rows.csv",
        columns(
            [*HEADER, "Remarks"],
            *TABLE.T,
            ["lamp on" if row == 40 else "" for row in range(60)],
            separator=";",
        ).encode(),
        tells="Left out: Remarks.",
    ),
    Form(
        "remarks_in_few_rows_under_another_word.csv",
        columns(
            [*HEADER, "Bemerkung"],
            *TABLE.T,
            ["Licht an" if row == 40 else "" for row in range(60)],
            separator=";",
        ).encode(),
        tells="Left out: Bemerkung.",
    ),
    Form(
        "comments_without_separators.csv",
        lines(LINES[0] + ",Note", *(line + ",paused" * (row == 5) for row, line in enumerate(LINES[1:]))),
        tells="Left out: Note.",
    ),
    Form("empty_columns.csv", lines(*(line + ",,," for line in LINES))),
    Form("blank_lines.csv", lines(*(part for line in LINES for part in (line, "")))),
    Form("comments_between.csv", lines(*LINES[:20], "# paused", *LINES[20:])),
    Form("torn_at_the_end.csv", text().encode()[:-12], False, TABLE[:-1], tells="--skip-bad-lines"),
    Form("fortran.txt", text(separator=" ", cell=lambda value: f"{value:.9E}".replace("E", "D")).encode()),
    Form(
        "apostrophes.csv", text(separator=";", cell=lambda value: f"{value:,.1f}".replace(",", "'")).encode()
    ),
    Form(
        "points_as_thousands.csv",
        text(separator=";", cell=lambda value: f"{value:,.1f}".translate(str.maketrans(",.", ".,"))).encode(),
    ),
    Form(
        "blanks_as_thousands.csv",
        text(
            separator=";", cell=lambda value: f"{value:,.1f}".replace(",", "\u202f").replace(".", ",")
        ).encode(),
    ),
    Form("long_minus.csv", text(cell=lambda value: shown(value).replace("-", "\u2212")).encode()),
    Form(
        "unclear_commas.csv",
        text(
            rows=np.abs(TABLE[:9] * 0.0 + 1.125) + np.arange(9)[:, None],
            separator=";",
            cell=lambda value: f"{value:.3f}".replace(".", ","),
        ).encode(),
        False,
        np.abs(TABLE[:9] * 0.0 + 1.125) + np.arange(9)[:, None],
        tells="--decimal comma",
    ),
    Form(
        "overload_of_scpi.csv",
        lines(*LINES[:10], LINES[10].rpartition(",")[0] + ",9.9E37", *LINES[11:]),
        expected=with_nan((9, 7)),
    ),
    Form(
        "a_sensor_that_was_off.csv",
        lines(*LINES[:10], ",".join(LINES[10].split(",")[:5]) + ",,,", *LINES[11:]),
        expected=np.delete(TABLE, 9, axis=0),
        tells="1 row left out (line 11)",
    ),
    Form(
        "no_header.csv",
        lines(*LINES[1:]),
        False,
        answer=PLAIN.encode(),
        tells="put a line above that names each",
    ),
]
