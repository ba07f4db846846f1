"""More forms, written when the importer had been finished; those named `real_` have the layout of files in people's repositories."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence

import numpy as np

from tests.estimator.store.importers.forms.written import HEADER, TABLE, Form, shown, text, with_times

T, CURRENT, X, Y, Z, BX, BY, BZ = TABLE.T
MILLI = TABLE / [1, 1, 1, 1, 1, 1e3, 1e3, 1e3]
IN_T = TABLE / [1, 1, 1, 1, 1, 1e6, 1e6, 1e6]
OF_FIELD = {"Bx": "uT", "By": "uT", "Bz": "uT"}
NAN_IN = np.zeros(TABLE.shape)
NAN_IN[[3, 5, 7, 9, 11], 7] = np.nan


def rows(cells: np.ndarray = TABLE, separator: str = ",", cell: Callable[[float], str] = shown) -> list[str]:
    return [separator.join(cell(value) for value in row) for row in cells]


def lines(*parts: str, end: str = "\n") -> bytes:
    return (end.join(parts) + end).encode()


def with_words(*columns: Sequence[object], separator: str = ",") -> list[str]:
    told = [[shown(c) if isinstance(c, float) else str(c) for c in row] for row in zip(*columns, strict=True)]
    return [separator.join(row) for row in told]


def nanoseconds(start: int) -> list[int]:
    return [start + int(1e9 * t) for t in T]


RECORDS = [dict(zip(HEADER, map(float, row), strict=True)) for row in TABLE]
NESTED = [
    {"t_s": r[0], "current": {"A": r[1]}, "position_mm": list(r[2:5]), "B_uT": list(r[5:])} for r in TABLE
]
DECLARED = [
    # Opera's tables of fields: a numbered line for each column, then a zero.
    Form(
        "real_opera.table",
        lines(
            " 5 4 3 2",
            *(f" {i} {name}" for i, name in enumerate(("X [MM]", "Y [MM]", "Z [MM]"), 1)),
            *(f" {i} B{axis} [TESLA]" for i, axis in enumerate("XYZ", 4)),
            " 0",
            *rows(IN_T[:, 2:], "      ", lambda value: f"{value:.12E}"),
        ),
        False,
        np.column_stack((np.arange(60.0), T * 0 + 3, *TABLE.T[2:])),
        {"AMPERE": "3"},
        tells="--constant coil1_current_A=",
    ),
    # Quantum Design: a header of key words, and an empty column of comments in front.
    Form(
        "real_quantum_design.dat",
        lines(
            "[Header]",
            "; data file",
            "TITLE,run 3",
            "BYAPP,Mapper,1.0",
            "INFO,coil A,SAMPLE",
            "[Data]",
            "Comment,Time Stamp (sec),Temperature (K),Current (A),X Position (mm),Y Position (mm),Z Position (mm),"
            "Magnetic Field X (Oe),Magnetic Field Y (Oe),Magnetic Field Z (Oe)",
            *with_words([""] * 60, T, [300] * 60, CURRENT, X, Y, Z, BX / 100, BY / 100, BZ / 100),
        ),
    ),
    # An app that logs sensors of telephones: nanoseconds since 1970, seconds, components backwards.
    Form(
        "real_sensor_logger.csv",
        lines(
            "time,seconds_elapsed,current_A,x_mm,y_mm,z_mm,mag_z_uT,mag_y_uT,mag_x_uT",
            *with_words(nanoseconds(1767620467350470700), T, CURRENT, X, Y, Z, BZ, BY, BX),
        ),
        expected=with_times(1767620467.3504707 + T),
    ),
    # Loggers of inertial units: milliseconds, and no units for the rest.
    Form(
        "real_imu.csv",
        lines(
            "timestamp_ms,label,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z,mag_x,mag_y,mag_z,I (A),px (mm),py (mm),pz (mm)",
            *with_words(1e3 * T, ["run"] * 60, *[T * 0] * 6, BX, BY, BZ, CURRENT, X, Y, Z),
        ),
        False,
        units=OF_FIELD,
        tells="'mag_x', 'mag_y', 'mag_z' must have a unit",
    ),
    # A gaussmeter's program, with the size of the field and a temperature.
    Form(
        "real_gaussmeter.csv",
        lines(
            "timestamp_s,current_a,pos_x_mm,pos_y_mm,pos_z_mm,field_x_mt,field_y_mt,field_z_mt,field_total_mt,freq_hz,temp_c",
            *with_words(*MILLI.T, T, T * 0, T * 0),
        ),
        False,
        units={"coil1_current": "A"},
        tells="'current_a' must have a unit",
    ),
    # ROS: nanoseconds, a frame's name, and units that only the message knows.
    Form(
        "real_rostopic.csv",
        lines(
            "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.magnetic_field.x,field.magnetic_field.y,"
            "field.magnetic_field.z,field.pose.position.x,field.pose.position.y,field.pose.position.z,current_A",
            *with_words(
                nanoseconds(1700000000000000000),
                range(60),
                nanoseconds(1700000000000000000),
                ["probe"] * 60,
                *IN_T.T[5:],
                *TABLE.T[2:5] / 1e3,
                CURRENT,
            ),
        ),
        False,
        with_times(1.7e9 + T),
        dict.fromkeys(("Bx", "By", "Bz"), "T") | {f"stage_{axis}": "m" for axis in "xyz"},
        tells="'field.magnetic_field.x'",
    ),
    Form(
        "numbered_comments.txt",
        lines(
            *(f"# column {i}: {name}" for i, name in enumerate(HEADER, 1)),
            *rows(separator=" "),
        ),
    ),
    Form(
        "sdds.sdds",
        lines(
            "SDDS1",
            "&column name=t, units=s, type=double, &end",
            "&column name=Current, units=A, type=double, &end",
            *(f"&column name={axis}, units=mm, type=double, &end" for axis in "xyz"),
            *(f"&column name=B{axis}, units=T, type=double, &end" for axis in "xyz"),
            "&data mode=ascii, no_row_counts=1 &end",
            *rows(IN_T, " ", lambda value: f"{value:.12g}"),
        ),
    ),
    Form(
        "igor.itx",
        lines(
            "IGOR",
            "WAVES/D\tt_s, I_A, x_mm, y_mm, z_mm, Bx_uT, By_uT, Bz_uT",
            "BEGIN",
            *("\t" + row for row in rows(separator="\t")),
            "END",
            end="\r",
        ),
        False,
        tells="--skip-bad-lines",
    ),
    Form(
        "qcodes.dat",
        lines(
            "# t\tI\tx\ty\tz\tBx\tBy\tBz",
            '# "Time (s)"\t"Current (A)"\t"X position (mm)"\t"Y position (mm)"\t"Z position (mm)"\t'
            '"Field x (uT)"\t"Field y (uT)"\t"Field z (uT)"',
            "# 60",
            *rows(separator="\t"),
        ),
    ),
]
HEADINGS = [
    Form(
        "two_headers.csv",
        lines(",,Position,,,Field,,", "Time,Current,x,y,z,Bx,By,Bz", "s,A,mm,mm,mm,uT,uT,uT", *rows()),
    ),
    Form(
        "groups_with_units.csv",
        lines("Time [s],Current [A],Position [mm],,,Field [uT],,", ",,x,y,z,x,y,z", *rows()),
    ),
    Form(
        "groups_over_units.csv",
        lines("Time,Current,Position,,,Field,,", "[s],[A],x,y,z,x,y,z", "s,A,mm,mm,mm,uT,uT,uT", *rows()),
    ),
    Form(
        "latex.csv",
        lines("$t$ [s],$I$ [A],$x$ [mm],$y$ [mm],$z$ [mm],$B_x$ [mT],$B_{y}$ [mT],B_{z} [mT]", *rows(MILLI)),
    ),
    Form("din.txt", lines("t/s\tI/A\tx/mm\ty/mm\tz/mm\tBx/mT\tBy/mT\tBz/mT", *rows(MILLI, "\t"))),
    Form(
        "german.csv",
        text(
            [
                "Zeit [s]",
                "Strom [A]",
                "Weg x [mm]",
                "Weg y [mm]",
                "Weg z [mm]",
                *(f"Feld B{a} [mT]" for a in "xyz"),
            ],
            MILLI,
            ";",
            ",",
        ).encode(),
    ),
    Form(
        "french.csv",
        text(
            ["Temps (s)", "Courant (A)", *(f"{a} (mm)" for a in "XYZ"), *(f"Champ {a} (mT)" for a in "XYZ")],
            MILLI,
            ";",
            ",",
        ).encode(),
    ),
    Form(
        "set_and_measured.csv",
        lines(
            "t_s,I_set (A),I_meas (A),x_set (mm),y_set (mm),z_set (mm),x_meas (mm),y_meas (mm),z_meas (mm),Bx (uT),By (uT),Bz (uT)",
            *with_words(T, CURRENT + 1, CURRENT, X + 1, Y + 1, Z + 1, X, Y, Z, BX, BY, BZ),
        ),
        tells="Left out: I_set (A), x_set (mm)",
    ),
    Form(
        "inches.csv",
        lines(
            "Time (s),Current (A),X (in),Y (in),Z (in),Bx (nT),By (nT),Bz (nT)",
            *rows(TABLE * [1, 1, *[1 / 25.4] * 3, *[1e3] * 3]),
        ),
    ),
    Form(
        "steps.csv",
        lines("Time (s),Current (A),X (steps),Y (mm),Z (mm),Bx (uT),By (uT),Bz (uT)", *rows()),
        False,
        answer=text().encode(),
        tells="'steps' is none of m, cm, mm, um, nm, in: convert the column",
    ),
    Form(
        "cylindrical.csv",
        lines("t_s,I_A,r (mm),phi (deg),z (mm),Br (uT),Bphi (uT),Bz (uT)", *rows()),
        False,
        answer=text().encode(),
        tells="look cylindrical: convert them",
    ),
    Form(
        "a_row_for_each_component.csv",
        lines(
            "t_s,I_A,x_mm,y_mm,z_mm,axis,field_uT",
            *with_words(*np.repeat(TABLE[:, :5], 3, 0).T, "xyz" * 60, TABLE[:, 5:].ravel()),
        ),
        False,
        answer=text().encode(),
        tells="a row must hold all components of a reading; 'axis'",
    ),
    Form(
        "exchanged.csv",
        lines(
            *(f"{name},{','.join(map(shown, column))}" for name, column in zip(HEADER, TABLE.T, strict=True))
        ),
        False,
        answer=text().encode(),
        tells="exchange rows and columns",
    ),
]
CELLS = [
    Form(
        "microtesla_called_tesla.csv",
        text([*HEADER[:5], "Bx_T", "By_T", "Bz_T"]).encode(),
        False,
        tells="fields look like uT",
    ),
    Form(
        "uncertainties.csv",
        lines(
            ",".join(HEADER),
            *with_words(*TABLE.T[:5], *([f"{shown(b)} ± 1.0" for b in c] for c in TABLE.T[5:])),
        ),
    ),
    Form(
        "digits_in_doubt.csv",
        lines(
            ",".join(HEADER),
            *with_words(*TABLE.T[:5], *([f"{shown(b)}(10)" for b in c] for c in TABLE.T[5:])),
        ),
    ),
    Form(
        "words_for_nothing.csv",
        lines(
            ",".join(HEADER),
            *with_words(
                *TABLE.T[:7],
                [
                    {3: "#N/A", 5: "OL", 7: "--", 9: "overload", 11: "Inf"}.get(i, shown(b))
                    for i, b in enumerate(BZ)
                ],
            ),
        ),
        expected=TABLE + NAN_IN,
        tells="5 cells of fields count as not measured: #N/A in line 5, OL in line 7, -- in line 9 and 2 more.",
    ),
    Form(
        "durations.csv",
        lines(",".join(["Elapsed", *HEADER[1:]]), *with_words([f"0:00:{t:04.1f}" for t in T], *TABLE.T[1:])),
    ),
    Form(
        "units_in_cells.csv",
        lines(
            "t,I,x,y,z,Bx,By,Bz",
            *(
                ",".join(
                    f"{shown(v)} {unit}"
                    for v, unit in zip(row, ("s", "A", "mm", "mm", "mm", *["uT"] * 3), strict=True)
                )
                for row in TABLE
            ),
        ),
        False,
        answer=text().encode(),
        tells="write units into the header, such as t [s], and only numbers below",
    ),
    Form(
        "vectors_in_cells.csv",
        lines(
            "t (s);I (A);position (mm);B (uT)",
            *(
                f"{shown(r[0])};{shown(r[1])};({', '.join(map(shown, r[2:5]))});({', '.join(map(shown, r[5:]))})"
                for r in TABLE
            ),
        ),
        False,
        answer=text().encode(),
        tells="write each component into a column of its own",
    ),
    Form(
        "commas_for_all.csv",
        lines(",".join(HEADER), *rows(cell=lambda value: f"{value:.2f}".replace(".", ","))),
        False,
        answer=text(separator=";", decimal=",").encode(),
        tells="export it with semicolons between cells",
    ),
    Form(
        "markdown.md",
        lines(
            f"| {' | '.join(HEADER)} |", "|" + "---|" * 8, *(f"| {row} |" for row in rows(separator=" | "))
        ),
    ),
    Form("records.json", json.dumps({"rig": "bench", "readings": RECORDS}).encode()),
    Form("records_a_line.jsonl", lines(*map(json.dumps, NESTED))),
    Form(
        "lists.json",
        json.dumps({name: list(column) for name, column in zip(HEADER, TABLE.T, strict=True)}).encode(),
    ),
]
FRESH = [*DECLARED, *HEADINGS, *CELLS]
