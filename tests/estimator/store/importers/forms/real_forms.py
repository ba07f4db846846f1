"""Forms with header and layout of files in people's repositories, and of formats that declare their columns."""

from __future__ import annotations

import numpy as np

from tests.estimator.store.importers.forms import written as w
from tests.estimator.store.importers.forms.written import REST, TABLE, Form, columns, lines, text

T, CURRENT, X, Y, Z, BX, BY, BZ = TABLE.T
ZERO = np.zeros(60)
NANOSECONDS = [1700000000000000000 + int(1e9 * t) for t in T]


REAL = [
    # phyphox and other apps for magnetometers of telephones: all names quoted, a column with the size.
    Form(
        "real_telephone.csv",
        text(
            '"Time (s)","I (A)","x (mm)","y (mm)","z (mm)","Magnetic field x (µT)","Magnetic field y (µT)","Magnetic field z (µT)","Absolute field (µT)"',
            np.column_stack((TABLE, np.hypot(BX, BY))),
            cell=lambda value: f"{value:.9E}",
        ),
    ),
    # LabVIEW: two headers, decimal commas, a column of comments that is not there.
    Form(
        "real_labview.lvm",
        text(
            "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\nDate\t2019/07/22\nTime\t17:18:18,938945770263671875\n***End_of_Header***\t\n\t\n"
            "Channels\t7\t\nSamples\t60\t60\t60\nX_Dimension\tTime\tTime\tTime\nX0\t0,0000000000000000E+0\t0,0000000000000000E+0\t0,0000000000000000E+0\n***End_of_Header***\t\t\t\n"
            "X_Value\tCurrent (A)\tX (mm)\tY (mm)\tZ (mm)\tBx (uT)\tBy (uT)\tBz (uT)\tComment",
            separator="\t",
            cell=lambda value: f"{value:.6f}".replace(".", ","),
        ),
        tells="more lines above the rows left out",
    ),
    # pandas with its index, means and deviations, expected fields.
    Form(
        "real_pandas.csv",
        columns(
            ",t [s],I [A],U [V],x [mm],y [mm],z [mm],mean Bx [mT],mean By [mT],mean Bz [mT],std Bx [mT],std By [mT],std Bz [mT],"
            "expected Bx [mT],expected By [mT],expected Bz [mT]",
            *(range(60), T, CURRENT, 2 * CURRENT, *w.MILLI.T[2:], *[[0.01] * 60] * 3, *[[0.5] * 60] * 3),
        ),
    ),
    # A field of a simulation beside the own one.
    Form(
        "real_two_maps.csv",
        columns(
            "t_s,I (A),X(mm),Y(mm),Z(mm),cvmfs_Bx(G),cvmfs_By(G),cvmfs_Bz(G),my_Bx(G),my_By(G),my_Bz(G)",
            *(*TABLE.T[:5], *[[1.0] * 60] * 3, *w.IN_G.T[5:]),
        ),
        False,
        units={"-": "cvmfs"},
        tells="may both be it",
    ),
    # COMSOL: comments with %, the unit of lengths in one of them.
    Form(
        "real_comsol.txt",
        text(
            "% Model:              coil.mph\n% Dimension:          3\n% Nodes:              60\n% Length unit:        mm\n"
            "% x                       y                        z                        t (s)     I (A)     mf.Bx (T)                mf.By (T)                mf.Bz (T)",
            w.IN_T[:, [2, 3, 4, 0, 1, 5, 6, 7]],
            separator=" ",
        ),
        False,
        units=w.UNITS,
        tells="must have a unit",
    ),
    # A node of ROS that scans with an arm: quaternions, names of frames, no units.
    Form(
        "real_ros_scan.csv",
        columns(
            "timestamp,mag_x,mag_y,mag_z,pos_x,pos_y,pos_z,ori_x,ori_y,ori_z,ori_w,sensor_id,frame_id,current",
            *(1.75e9 + T, BX, BY, BZ, X, Y, Z, ZERO, ZERO, ZERO, ZERO + 1, [1] * 60, ["base"] * 60, CURRENT),
        ),
        False,
        w.with_times(1.75e9 + T),
        w.UNITS,
        tells="must have a unit",
    ),
    # A logger with a time for each of its instruments.
    Form(
        "real_logger.csv",
        columns(
            "accel_timestamp,accel_x,mag_timestamp,mag_x (uT),mag_y (uT),mag_z (uT),temp,I (A),x (mm),y (mm),z (mm)",
            *(1e3 * T, ZERO, 1e3 * T, BX, BY, BZ, ZERO, CURRENT, X, Y, Z),
        ),
        False,
        units={"t": "ms", "-": "accel"},
        tells="may both be it",
    ),
    # An Arduino that prints names beside numbers.
    Form(
        "real_arduino.txt",
        lines(*(f"Bx [mT]:{x:.3f},By [mT]:{y:.3f},Bz [mT]:{z:.3f}" for x, y, z in w.MILLI[:, 5:])),
        False,
        answer=w.PLAIN,
        tells="no line holds two numbers",
    ),
    # Three supplies by number of their channel.
    Form(
        "real_channels.csv",
        columns(f"t [s],channel 1 [A],channel 2 [A],{REST[16:]}", T, CURRENT, CURRENT + 1, *TABLE.T[2:]),
        rig=w.TWO_COILS,
    ),
    # A scan of an arm, places and rotation vector beside each other, degrees of what does not turn.
    Form(
        "real_trajectory.csv",
        columns(
            "x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg,t_s,current_A,Bx_uT,By_uT,Bz_uT,valid",
            *(X, Y, Z, ZERO, ZERO, ZERO, T, CURRENT, BX, BY, BZ, [1] * 60),
        ),
    ),
]
DECLARED = [
    # Opera's tables of fields: a numbered line for each column, then a zero.
    Form(
        "real_opera.table",
        lines(
            " 5 4 3 2\n 1 X [MM]\n 2 Y [MM]\n 3 Z [MM]\n 4 BX [TESLA]\n 5 BY [TESLA]\n 6 BZ [TESLA]\n 0",
            *("      ".join(f"{value:.12E}" for value in row) for row in w.IN_T[:, 2:]),
        ),
        False,
        np.column_stack((np.arange(60.0), T * 0 + 3, *TABLE.T[2:])),
        {"AMPERE": "3"},
        tells="--constant coil1_current_A=",
    ),
    # Quantum Design: a header of key words, and an empty column of comments in front.
    Form(
        "real_quantum_design.dat",
        columns(
            "[Header]\n; data file\nTITLE,run 3\nBYAPP,Mapper,1.0\nINFO,coil A,SAMPLE\n[Data]\n"
            "Comment,Time Stamp (sec),Temperature (K),Current (A),X Position (mm),Y Position (mm),Z Position (mm),"
            "Magnetic Field X (Oe),Magnetic Field Y (Oe),Magnetic Field Z (Oe)",
            *([""] * 60, T, [300] * 60, *w.IN_G.T[1:]),
        ),
    ),
    # An app that logs sensors of telephones: nanoseconds since 1970, seconds, components backwards.
    Form(
        "real_sensor_logger.csv",
        columns(
            "time,seconds_elapsed,current_A,x_mm,y_mm,z_mm,mag_z_uT,mag_y_uT,mag_x_uT",
            *([1767620467350470700 + int(1e9 * t) for t in T], *TABLE.T[:5], BZ, BY, BX),
        ),
        expected=w.with_times(1767620467.3504707 + T),
    ),
    # Loggers of inertial units: milliseconds, and no units for the rest.
    Form(
        "real_imu.csv",
        columns(
            "timestamp_ms,label,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z,mag_x,mag_y,mag_z,I (A),px (mm),py (mm),pz (mm)",
            *(1e3 * T, ["run"] * 60, *[ZERO] * 6, BX, BY, BZ, CURRENT, X, Y, Z),
        ),
        False,
        units={"Bx": "uT", "By": "uT", "Bz": "uT"},
        tells="'mag_x', 'mag_y', 'mag_z' must have a unit",
    ),
    # A gaussmeter's program, with the size of the field and a temperature.
    Form(
        "real_gaussmeter.csv",
        columns(
            "timestamp_s,current_a,pos_x_mm,pos_y_mm,pos_z_mm,field_x_mt,field_y_mt,field_z_mt,field_total_mt,freq_hz,temp_c",
            *(*w.MILLI.T, T, ZERO, ZERO),
        ),
        False,
        units={"coil1_current": "A"},
        tells="'current_a' must have a unit",
    ),
    # ROS: nanoseconds, a frame's name, and units that only the message knows.
    Form(
        "real_rostopic.csv",
        columns(
            "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.magnetic_field.x,field.magnetic_field.y,"
            "field.magnetic_field.z,field.pose.position.x,field.pose.position.y,field.pose.position.z,current_A",
            *(
                NANOSECONDS,
                range(60),
                NANOSECONDS,
                ["probe"] * 60,
                *w.IN_T.T[5:],
                X / 1e3,
                Y / 1e3,
                Z / 1e3,
                CURRENT,
            ),
        ),
        False,
        w.with_times(1.7e9 + T),
        dict.fromkeys(("Bx", "By", "Bz"), "T") | {f"stage_{axis}": "m" for axis in "xyz"},
        tells="'field.magnetic_field.x'",
    ),
    Form(
        "numbered_comments.txt",
        text("\n".join(f"# column {i}: {name}" for i, name in enumerate(w.HEADER, 1)), separator=" "),
    ),
    Form(
        "sdds.sdds",
        text(
            "SDDS1\n&column name=t, units=s, type=double, &end\n&column name=Current, units=A, type=double, &end\n"
            + "".join(f"&column name={axis}, units=mm, type=double, &end\n" for axis in "xyz")
            + "".join(f"&column name=B{axis}, units=T, type=double, &end\n" for axis in "xyz")
            + "&data mode=ascii, no_row_counts=1 &end",
            w.IN_T,
            " ",
            cell=lambda value: f"{value:.12g}",
        ),
    ),
    Form(
        "igor.itx",
        "IGOR\rWAVES/D\tt_s, I_A, x_mm, y_mm, z_mm, Bx_uT, By_uT, Bz_uT\rBEGIN\r"
        + "".join("\t" + line.replace(",", "\t") + "\r" for line in w.LINES[1:])
        + "END\r",
        False,
        tells="--skip-bad-lines",
    ),
    Form(
        "qcodes.dat",
        text(
            "# t\tI\tx\ty\tz\tBx\tBy\tBz\n"
            '# "Time (s)"\t"Current (A)"\t"X position (mm)"\t"Y position (mm)"\t"Z position (mm)"\t'
            '"Field x (uT)"\t"Field y (uT)"\t"Field z (uT)"\n# 60',
            separator="\t",
        ),
    ),
]
