"""Forms whose columns have other names, units, order or meaning."""

from __future__ import annotations

import numpy as np

from tests.estimator.store.importers.forms.pieces import (
    BARE,
    BX,
    BY,
    BZ,
    CURRENT,
    IN_G,
    LAB,
    NAN,
    NOON,
    UNITS,
    T,
    X,
    Y,
    Z,
    clock,
)
from tests.estimator.store.importers.forms.written import (
    HEADER,
    TABLE,
    TWO_COILS,
    TWO_SENSORS,
    Form,
    columns,
    scaled,
    text,
    with_times,
)

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
