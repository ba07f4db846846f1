"""Forms with header and layout of files in people's repositories."""

from __future__ import annotations

import numpy as np

from tests.estimator.store.importers.forms.pieces import (
    BX,
    BY,
    BZ,
    CURRENT,
    PLAIN,
    UNITS,
    T,
    X,
    Y,
    Z,
)
from tests.estimator.store.importers.forms.written import (
    HEADER,
    TABLE,
    TWO_COILS,
    Form,
    columns,
    text,
    with_times,
)

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
