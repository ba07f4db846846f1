"""The forms: 24 of bug reports, and more; those named `real_` have header and layout of files in people's repositories."""

from __future__ import annotations

import datetime
import io
from pathlib import Path

import numpy as np

from tests.estimator.store.importers.forms.written import (
    BROKEN_WORKBOOK,
    COMPRESSED,
    HEADER,
    TABLE,
    TWO_COILS,
    TWO_SENSORS,
    Form,
    columns,
    saved,
    scaled,
    shown,
    text,
    with_times,
    workbook,
)

T, CURRENT, X, Y, Z, BX, BY, BZ = TABLE.T
PLAIN = text()
LINES = PLAIN.splitlines()
MICRO = [*HEADER[:5], "Bx [µT]", "By [µT]", "Bz [µT]"]
LAB = ["Time [s]", "I coil (A)", "X [mm]", "Y [mm]", "Z [mm]", "Hall Bx/G", "Hall By/G", "Hall Bz/G"]
IN_G = [1.0, 1.0, 1.0, 1.0, 1.0, 100.0, 100.0, 100.0]
BARE = ["time", "current", "x", "y", "z", "bx", "by", "bz"]
UNITS = {
    "t": "s",
    "coil1_current": "A",
    "stage_x": "mm",
    "stage_y": "mm",
    "stage_z": "mm",
    "Bx": "uT",
    "By": "uT",
    "Bz": "uT",
}
NAN = float("nan")


def lines(*parts: str) -> bytes:
    return ("\n".join(parts) + "\n").encode()


def without_first_cell(line: str, cells: int) -> str:
    return ",".join(["", *line.split(",")[cells:]])


def with_nan(*places: tuple[int, int]) -> np.ndarray:
    rows = TABLE.copy()
    for place in places:
        rows[place] = NAN
    return rows


def clock(second: float, start: datetime.datetime, pattern: str) -> str:
    return (start + datetime.timedelta(seconds=second)).strftime(pattern)


NOON = datetime.datetime(2026, 3, 1, 12, 0, 0)
BACK = np.concatenate((T[:40], T[:20]))
ODD = np.concatenate((T[:40], T[:20] - 0.25))
AFTER = np.concatenate((T[:40], 20.0 + T[:20]))

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
OF_COLUMNS = [
    Form("laboratory.csv", ("Lab 3\n" + text(LAB, scaled(IN_G), separator=";", decimal=",")).encode()),
    Form(
        "gauss_and_cm.csv",
        text(
            [
                "t (sec)",
                "I (mA)",
                "pos x (cm)",
                "pos y (cm)",
                "pos z (cm)",
                "B_x(Gauss)",
                "B_y(Gauss)",
                "B_z(Gauss)",
            ],
            scaled([1, 1e-3, 10, 10, 10, 100, 100, 100]),
        ).encode(),
    ),
    Form(
        "commas_before_units.txt",
        text(
            ["Time, s", "Current, A", "X, mm", "Y, mm", "Z, mm", "Bx, mT", "By, mT", "Bz, mT"],
            scaled([1] * 5 + [1e3] * 3),
            separator="\t",
        ).encode(),
    ),
    Form(
        "tesla_and_metres.csv",
        text(
            ["time_s", "i_A", "x_m", "y_m", "z_m", "bx_T", "by_T", "bz_T"],
            scaled([1, 1, 1e3, 1e3, 1e3, 1e6, 1e6, 1e6]),
        ).encode(),
    ),
    Form("other_order.csv", text(HEADER[::-1], TABLE[:, ::-1]).encode()),
    Form(
        "unknown_columns.csv",
        columns([*LAB, "Humidity (%)", "Comment"], *scaled(IN_G).T, [40] * 60, ["ok, still"] * 60).encode(),
        tells="Left out: Humidity (%), Comment.",
    ),
    Form(
        "one_component.csv",
        columns([*HEADER[:5], "B_z (uT)"], T, CURRENT, X, Y, Z, BZ).encode(),
        expected=np.column_stack((T, CURRENT, X, Y, Z, T * NAN, T * NAN, BZ)),
        tells="Not measured: Bx, By.",
    ),
    Form(
        "field_without_axis.csv",
        columns([*HEADER[:5], "B (uT)"], T, CURRENT, X, Y, Z, BZ).encode(),
        False,
        np.column_stack((T, CURRENT, X, Y, Z, T * NAN, T * NAN, BZ)),
        {"B": "uT"},
        tells="must include a component of the field",
    ),
    Form(
        "no_time.csv",
        columns(HEADER[1:], *TABLE.T[1:]).encode(),
        expected=with_times(np.arange(60.0)),
        tells="No time: rows count as one second each.",
    ),
    Form(
        "no_current.csv",
        columns([HEADER[0], *HEADER[2:]], T, *TABLE.T[2:]).encode(),
        False,
        np.column_stack((T, T * 0 + 3, *TABLE.T[2:])),
        {"AMPERE": "3"},
        tells="--constant coil1_current_A=",
    ),
    Form(
        "along_one_axis.csv",
        columns(["t_s", "I [A]", "z [mm]", *HEADER[5:]], T, CURRENT, Z, BX, BY, BZ).encode(),
        False,
        np.column_stack((T, CURRENT, X * 0, X * 0, Z, BX, BY, BZ)),
        tells="--constant stage_x_m=0",
    ),
    Form(
        "two_currents.csv",
        columns(
            [*HEADER[:1], "I supply (A)", "I shunt (A)", *HEADER[2:]], T, CURRENT, CURRENT + 9, *TABLE.T[2:]
        ).encode(),
        expected=TABLE,
    ),
    Form(
        "two_like_currents.csv",
        columns(
            [*HEADER[:1], "I (A)", "Current (A)", *HEADER[2:]], T, CURRENT, CURRENT + 9, *TABLE.T[2:]
        ).encode(),
        False,
        tells="may both be it",
    ),
    Form(
        "euler_angles.csv",
        columns([*HEADER, "yaw (deg)"], *TABLE.T, T * 0).encode(),
        False,
        tells="rotation vector",
    ),
    Form("minutes.csv", text(["Elapsed time (min)", *HEADER[1:]], scaled([60] + [1] * 7)).encode()),
    Form(
        "date_and_time.csv",
        columns(
            ["Date", "Time", *HEADER[1:]],
            [clock(t, NOON, "%d.%m.%Y") for t in T],
            [clock(t, NOON, "%H:%M:%S.%f") for t in T],
            *TABLE.T[1:],
        ).encode(),
        expected=with_times(43200.0 + T),
    ),
    Form(
        "iso_times.csv",
        columns(
            ["timestamp", *HEADER[1:]], [clock(t, NOON, "%Y-%m-%dT%H:%M:%S.%f") for t in T], *TABLE.T[1:]
        ).encode(),
        expected=with_times(43200.0 + T),
    ),
    Form(
        "american_times.csv",
        columns(
            ["Time", *HEADER[1:]],
            [clock(t, NOON.replace(day=21), "%m/%d/%Y %I:%M:%S.%f %p") for t in T],
            *TABLE.T[1:],
        ).encode(),
        expected=with_times(43200.0 + T),
    ),
    Form(
        "over_midnight.csv",
        columns(
            ["Time", *HEADER[1:]],
            [clock(t - 10, NOON.replace(hour=0), "%H:%M:%S.%f") for t in T],
            *TABLE.T[1:],
        ).encode(),
        expected=with_times(86390.0 + T),
    ),
    Form(
        "minutes_of_a_spreadsheet.csv",
        columns(
            ["Time", *HEADER[1:]], [f"{int(t // 60):02d}:{t % 60:04.1f}" for t in T], *TABLE.T[1:]
        ).encode(),
    ),
    Form(
        "dates_of_two_kinds.csv",
        columns(
            ["Time", *HEADER[1:]],
            [clock(86400 * t, NOON.replace(day=1), "%d/%m/%Y %H:%M:%S") for t in T[:20]],
            *TABLE[:20].T[1:],
        ).encode(),
        False,
        with_times(43200 + 86400 * T)[:20],
        answer=columns(
            ["Time", *HEADER[1:]],
            [clock(86400 * t, NOON.replace(day=1), "%Y-%m-%d %H:%M:%S") for t in T[:20]],
            *TABLE[:20].T[1:],
        ).encode(),
        tells="write them as 2026-03-01",
    ),
    Form(
        "epoch.csv",
        text(["timestamp", *HEADER[1:]], with_times(1.75e9 + T), cell=lambda value: f"{value:.1f}").encode(),
        expected=with_times(1.75e9 + T),
    ),
    Form(
        "epoch_in_ms.csv",
        columns(
            ["Timestamp", *HEADER[1:]], [f"{1750000000000 + 1000 * t:.0f}" for t in T], *TABLE.T[1:]
        ).encode(),
        expected=with_times(1.75e9 + T),
    ),
    Form("all_without_units.csv", text(BARE).encode(), False, units=UNITS, tells="'time', 'current', 'x'"),
    Form(
        "sensors_in_columns.csv",
        columns(
            [
                "t_s",
                "I (A)",
                "X (mm)",
                "Y (mm)",
                "Z (mm)",
                *(f"Probe{n} B{axis} (uT)" for n in (1, 2) for axis in "xyz"),
            ],
            T,
            CURRENT,
            X,
            Y,
            Z,
            BX,
            BY,
            BZ,
            BX + 1,
            BY + 1,
            BZ + 1,
        ).encode(),
        expected=np.stack((TABLE, TABLE + np.repeat([0.0, 1.0], [5, 3])), 1).reshape(120, 8),
        rig=TWO_SENSORS,
    ),
    Form(
        "sensors_in_columns_with_overloads.csv",
        columns(
            [*HEADER[:5], *(f"Probe{n} B{axis} (uT)" for n in (1, 2) for axis in "xyz")],
            *(
                T,
                CURRENT,
                X,
                Y,
                Z,
                BX,
                BY,
                BZ,
                BX,
                ["OVLD" if i == 7 else value for i, value in enumerate(BY)],
                BZ,
            ),
        ).encode(),
        expected=np.repeat(TABLE, 2, axis=0)
        + np.where(np.outer(np.arange(120) == 15, np.arange(8) == 6), NAN, 0.0),
        rig=TWO_SENSORS,
        tells="1 cell of a field counts as not measured: OVLD in line 9.",
    ),
    Form(
        "numbered_coils.csv",
        columns(
            [*HEADER[:1], "I1 [A]", "I2 [A]", *HEADER[2:]], T, CURRENT, CURRENT + 1, *TABLE.T[2:]
        ).encode(),
        rig=TWO_COILS,
    ),
    Form(
        "one_current_in_two_coils.csv",
        text([*HEADER[:1], "I [A]", *HEADER[2:]]).encode(),
        is_read=False,
        rig=TWO_COILS,
        tells="coil2_current_A  -3 A",
    ),
]
REAL = [
    # phyphox and other apps for magnetometers of telephones: all names quoted, a column with the size.
    Form(
        "real_telephone.csv",
        (
            '"Time (s)","I (A)","x (mm)","y (mm)","z (mm)","Magnetic field x (µT)","Magnetic field y (µT)","Magnetic field z (µT)","Absolute field (µT)"\n'
            + "".join(
                ",".join(f"{value:.9E}" for value in (*row, np.hypot(row[5], row[6]))) + "\n" for row in TABLE
            )
        ).encode(),
    ),
    # LabVIEW: two headers, decimal commas, a column of comments that is not there.
    Form(
        "real_labview.lvm",
        (
            "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nDate\t2019/07/22\nTime\t17:18:18,938945770263671875\n***End_of_Header***\t\n\t\n"
            "Channels\t7\t\nSamples\t60\t60\t60\nX_Dimension\tTime\tTime\tTime\nX0\t0,0000000000000000E+0\t0,0000000000000000E+0\t0,0000000000000000E+0\n***End_of_Header***\t\t\t\n"
            + "\t".join(
                [
                    "X_Value",
                    "Current (A)",
                    "X (mm)",
                    "Y (mm)",
                    "Z (mm)",
                    "Bx (uT)",
                    "By (uT)",
                    "Bz (uT)",
                    "Comment",
                ]
            )
            + "\n"
            + text(separator="\t", cell=lambda value: f"{value:.6f}".replace(".", ",")).split("\n", 1)[1]
        ).encode(),
        tells="more lines above the rows left out",
    ),
    # pandas with its index, means and deviations, expected fields.
    Form(
        "real_pandas.csv",
        columns(
            [
                "",
                "t [s]",
                "I [A]",
                "U [V]",
                "x [mm]",
                "y [mm]",
                "z [mm]",
                *(f"{kind} B{axis} [mT]" for kind in ("mean", "std", "expected") for axis in "xyz"),
            ],
            range(60),
            T,
            CURRENT,
            2 * CURRENT,
            X,
            Y,
            Z,
            BX / 1e3,
            BY / 1e3,
            BZ / 1e3,
            *[[0.01] * 60] * 3,
            *[[0.5] * 60] * 3,
        ).encode(),
    ),
    # A field of a simulation beside the own one.
    Form(
        "real_two_maps.csv",
        columns(
            [
                "t_s",
                "I (A)",
                "X(mm)",
                "Y(mm)",
                "Z(mm)",
                *(f"{kind}_B{axis}(G)" for kind in ("cvmfs", "my") for axis in "xyz"),
            ],
            T,
            CURRENT,
            X,
            Y,
            Z,
            *[[1.0] * 60] * 3,
            BX / 100,
            BY / 100,
            BZ / 100,
        ).encode(),
        False,
        units={"-": "cvmfs"},
        tells="may both be it",
    ),
    # COMSOL: comments with %, the unit of lengths in one of them.
    Form(
        "real_comsol.txt",
        (
            "% Model:              coil.mph\n% Dimension:          3\n% Nodes:              60\n% Length unit:        mm\n"
            "% x                       y                        z                        t (s)     I (A)     mf.Bx (T)                mf.By (T)                mf.Bz (T)\n"
            + text(
                HEADER, TABLE[:, [2, 3, 4, 0, 1, 5, 6, 7]] / [1, 1, 1, 1, 1, 1e6, 1e6, 1e6], separator=" "
            ).split("\n", 1)[1]
        ).encode(),
        False,
        units=UNITS,
        tells="must have a unit",
    ),
    # A node of ROS that scans with an arm: quaternions, names of frames, no units.
    Form(
        "real_ros_scan.csv",
        columns(
            [
                "timestamp",
                "mag_x",
                "mag_y",
                "mag_z",
                "pos_x",
                "pos_y",
                "pos_z",
                "ori_x",
                "ori_y",
                "ori_z",
                "ori_w",
                "sensor_id",
                "frame_id",
                "current",
            ],
            1.75e9 + T,
            BX,
            BY,
            BZ,
            X,
            Y,
            Z,
            T * 0,
            T * 0,
            T * 0,
            T * 0 + 1,
            [1] * 60,
            ["base"] * 60,
            CURRENT,
        ).encode(),
        False,
        with_times(1.75e9 + T),
        UNITS,
        tells="must have a unit",
    ),
    # A logger with a time for each of its instruments.
    Form(
        "real_logger.csv",
        columns(
            [
                "accel_timestamp",
                "accel_x",
                "mag_timestamp",
                "mag_x (uT)",
                "mag_y (uT)",
                "mag_z (uT)",
                "temp",
                "I (A)",
                "x (mm)",
                "y (mm)",
                "z (mm)",
            ],
            1e3 * T,
            T * 0,
            1e3 * T,
            BX,
            BY,
            BZ,
            T * 0,
            CURRENT,
            X,
            Y,
            Z,
        ).encode(),
        False,
        units={"t": "ms", "-": "accel"},
        tells="may both be it",
    ),
    # An Arduino that prints names beside numbers.
    Form(
        "real_arduino.txt",
        "".join(
            f"Bx [mT]:{row[5] / 1e3:.3f},By [mT]:{row[6] / 1e3:.3f},Bz [mT]:{row[7] / 1e3:.3f}\n"
            for row in TABLE
        ).encode(),
        False,
        answer=PLAIN.encode(),
        tells="no line holds two numbers",
    ),
    # Three supplies by number of their channel.
    Form(
        "real_channels.csv",
        columns(
            ["t [s]", "channel 1 [A]", "channel 2 [A]", *HEADER[2:]], T, CURRENT, CURRENT + 1, *TABLE.T[2:]
        ).encode(),
        rig=TWO_COILS,
    ),
    # A scan of an arm, places and rotation vector beside each other, degrees of what does not turn.
    Form(
        "real_trajectory.csv",
        columns(
            [
                "x_mm",
                "y_mm",
                "z_mm",
                "rx_deg",
                "ry_deg",
                "rz_deg",
                "t_s",
                "current_A",
                "Bx_uT",
                "By_uT",
                "Bz_uT",
                "valid",
            ],
            X,
            Y,
            Z,
            T * 0,
            T * 0,
            T * 0,
            T,
            CURRENT,
            BX,
            BY,
            BZ,
            [1] * 60,
        ).encode(),
    ),
]
IN_KEYS = dict(zip(HEADER, TABLE.T, strict=True))


def of_libraries(folder: Path) -> list[Form]:
    """Forms that libraries write; those whose library is missing are left out."""
    import h5py
    import scipy.io

    def hdf5(path: Path) -> None:
        with h5py.File(path, "w") as file:
            group = file.create_group("run 1")
            for name, unit in (("time", "s"), ("current", "A")):
                group[name] = IN_KEYS["t_s" if name == "time" else "coil1_current_A"]
                group[name].attrs["unit"] = unit
            group["position"], group["field"] = TABLE[:, 2:5], TABLE[:, 5:]
            group["position"].attrs["units"], group["field"].attrs["units"] = "mm", "uT"

    npz = io.BytesIO()
    np.savez(npz, **IN_KEYS)
    day = datetime.datetime(2026, 3, 1, 12, 0, 0)
    sheet = [LAB, *scaled(IN_G).tolist()]
    dated = [
        ["Run 7"],
        [],
        ["Time", *LAB[1:]],
        *([day + datetime.timedelta(seconds=row[0]), *row[1:]] for row in scaled(IN_G).tolist()),
    ]
    forms = [
        Form("arrays.h5", saved(hdf5, folder, "arrays.h5")),
        Form("arrays.mat", saved(lambda path: scipy.io.savemat(path, IN_KEYS), folder, "arrays.mat")),
        Form("arrays.npz", npz.getvalue()),
        Form(
            "old.xls",
            b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\0" * 600,
            False,
            answer=PLAIN.encode(),
            tells="save it as .xlsx or CSV",
        ),
        Form("packed.csv.gz", COMPRESSED, False, answer=PLAIN.encode(), tells="unpack it with gunzip"),
        Form("workbook.xlsx", workbook({"Notes": [["nothing", "here"]], "Data": sheet})),
        Form("workbook_with_dates.xlsx", workbook({"Data": dated}), expected=with_times(43200.0 + T)),
    ]
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        return [form for form in forms if form.content]
    frame = pyarrow.table(dict(zip(LAB, scaled(IN_G).T, strict=True)))
    parquet = saved(lambda path: pyarrow.parquet.write_table(frame, path), folder, "frame.parquet")
    return [form for form in [*forms, Form("frame.parquet", parquet)] if form.content]


TEXTS = [*OF_REPORTS, *OF_TEXT, *OF_COLUMNS, *REAL]
