"""Forms whose columns have other names, units, order, headers or meaning."""

from __future__ import annotations

import numpy as np

from tests.estimator.store.importers.forms import written as w
from tests.estimator.store.importers.forms.written import (
    HEAD,
    PLACES,
    REST,
    TABLE,
    Form,
    columns,
    lines,
    text,
)

T, CURRENT, X, Y, Z, BX, BY, BZ = TABLE.T
NOTHING = np.full(60, np.nan)
ALONG_Z = np.column_stack((TABLE[:, :5], NOTHING, NOTHING, BZ))
OF_TWO_SENSORS = f"{PLACES}," + ",".join(f"Probe{n} B{axis} (uT)" for n in (1, 2) for axis in "xyz")
DAYS = {"time_s": 86400 * T[:20], "day": 1}
OF_COLUMNS = [
    Form("laboratory.csv", "Lab 3\n" + text(w.LAB.split(","), w.IN_G, separator=";", decimal=",")),
    Form(
        "gauss_and_cm.csv",
        text(
            "t (sec),I (mA),pos x (cm),pos y (cm),pos z (cm),B_x(Gauss),B_y(Gauss),B_z(Gauss)",
            TABLE / [1, 1e-3, 10, 10, 10, 100, 100, 100],
        ),
    ),
    Form(
        "commas_before_units.txt",
        text("Time, s\tCurrent, A\tX, mm\tY, mm\tZ, mm\tBx, mT\tBy, mT\tBz, mT", w.MILLI, separator="\t"),
    ),
    Form(
        "tesla_and_metres.csv",
        text("time_s,i_A,x_m,y_m,z_m,bx_T,by_T,bz_T", TABLE / [1, 1, 1e3, 1e3, 1e3, 1e6, 1e6, 1e6]),
    ),
    Form("other_order.csv", text(w.HEADER[::-1], TABLE[:, ::-1])),
    Form(
        "unknown_columns.csv",
        columns(f"{w.LAB},Humidity (%),Comment", *w.IN_G.T, [40] * 60, ["ok, still"] * 60),
        tells="Left out: Humidity (%), Comment.",
    ),
    Form(
        "one_component.csv",
        columns(f"{PLACES},B_z (uT)", *TABLE.T[:5], BZ),
        expected=ALONG_Z,
        tells="Not measured: Bx, By.",
    ),
    Form(
        "field_without_axis.csv",
        columns(f"{PLACES},B (uT)", *TABLE.T[:5], BZ),
        False,
        ALONG_Z,
        tells="it may be 'B (uT)': say along which axis of the sensor with --column 'B (uT)=Bz_uT'",
    ),
    Form(
        "strength.csv",
        columns(f"{PLACES},|B| (uT)", *TABLE.T[:5], np.abs(BZ)),
        False,
        answer=text(),
        tells="'|B| (uT)' is a strength without direction or sign: read components",
    ),
    Form(
        "no_time.csv",
        text(REST, TABLE[:, 1:]),
        expected=w.with_times(np.arange(60.0)),
        tells="No time: rows count as one second each.",
    ),
    Form(
        "no_current.csv",
        columns(HEAD.replace("coil1_current_A,", ""), T, *TABLE.T[2:]),
        False,
        np.column_stack((T, T * 0 + 3, *TABLE.T[2:])),
        {"AMPERE": "3"},
        tells="--constant coil1_current_A=",
    ),
    Form(
        "along_one_axis.csv",
        columns("t_s,I [A],z [mm],Bx_uT,By_uT,Bz_uT", T, CURRENT, *TABLE.T[4:]),
        False,
        TABLE * [1, 1, 0, 0, 1, 1, 1, 1],
        tells="--constant stage_x_m=0",
    ),
    Form(
        "two_currents.csv",
        columns(f"t_s,I supply (A),I shunt (A),{REST[16:]}", T, CURRENT, CURRENT + 9, *TABLE.T[2:]),
    ),
    Form(
        "two_like_currents.csv",
        columns(f"t_s,I (A),Current (A),{REST[16:]}", T, CURRENT, CURRENT + 9, *TABLE.T[2:]),
        False,
        tells="may both be it",
    ),
    Form("euler_angles.csv", columns(f"{HEAD},yaw (deg)", *TABLE.T, T * 0), False, tells="rotation vector"),
    Form("minutes.csv", text(f"Elapsed time (min),{REST}", w.with_times(T / 60))),
    Form(
        "date_and_time.csv",
        columns(f"Date,Time,{REST}", w.clocks("%d.%m.%Y"), w.clocks("%H:%M:%S.%f"), *TABLE.T[1:]),
        expected=w.with_times(43200.0 + T),
    ),
    Form(
        "iso_times.csv",
        columns(f"timestamp,{REST}", w.clocks("%Y-%m-%dT%H:%M:%S.%f"), *TABLE.T[1:]),
        expected=w.with_times(43200.0 + T),
    ),
    Form(
        "american_times.csv",
        columns(f"Time,{REST}", w.clocks("%m/%d/%Y %I:%M:%S.%f %p", day=21), *TABLE.T[1:]),
        expected=w.with_times(43200.0 + T),
    ),
    Form(
        "over_midnight.csv",
        columns(f"Time,{REST}", w.clocks("%H:%M:%S.%f", T - 10, hour=0), *TABLE.T[1:]),
        expected=w.with_times(86390.0 + T),
    ),
    Form(
        "minutes_of_a_spreadsheet.csv",
        columns(f"Time,{REST}", [f"{int(t // 60):02d}:{t % 60:04.1f}" for t in T], *TABLE.T[1:]),
    ),
    Form(
        "dates_of_two_kinds.csv",
        columns(f"Time,{REST}", w.clocks("%d/%m/%Y %H:%M:%S", **DAYS), *TABLE[:20].T[1:]),
        False,
        w.with_times(43200 + 86400 * T)[:20],
        answer=columns(f"Time,{REST}", w.clocks("%Y-%m-%d %H:%M:%S", **DAYS), *TABLE[:20].T[1:]),
        tells="write them as 2026-03-01",
    ),
    Form(
        "epoch.csv",
        text(f"timestamp,{REST}", w.with_times(1.75e9 + T), cell=lambda value: f"{value:.1f}"),
        expected=w.with_times(1.75e9 + T),
    ),
    Form(
        "epoch_in_ms.csv",
        columns(f"Timestamp,{REST}", [f"{1750000000000 + 1000 * t:.0f}" for t in T], *TABLE.T[1:]),
        expected=w.with_times(1.75e9 + T),
    ),
    Form(
        "all_without_units.csv",
        text("time,current,x,y,z,bx,by,bz"),
        False,
        units=w.UNITS,
        tells="'time', 'current', 'x'",
    ),
    Form(
        "sensors_in_columns.csv",
        columns(OF_TWO_SENSORS, *TABLE.T, BX + 1, BY + 1, BZ + 1),
        expected=np.stack((TABLE, TABLE + np.repeat([0.0, 1.0], [5, 3])), 1).reshape(120, 8),
        rig=w.TWO_SENSORS,
    ),
    Form(
        "sensors_in_columns_with_overloads.csv",
        columns(OF_TWO_SENSORS, *TABLE.T, BX, ["OVLD" if i == 7 else b for i, b in enumerate(BY)], BZ),
        expected=np.repeat(TABLE, 2, axis=0)
        + np.where(np.arange(960).reshape(120, 8) == 8 * 15 + 6, np.nan, 0),
        rig=w.TWO_SENSORS,
        tells="1 cell of a field counts as not measured: OVLD in line 9.",
    ),
    Form(
        "numbered_coils.csv",
        columns(f"t_s,I1 [A],I2 [A],{REST[16:]}", T, CURRENT, CURRENT + 1, *TABLE.T[2:]),
        rig=w.TWO_COILS,
    ),
    Form(
        "one_current_in_two_coils.csv",
        text(f"t_s,I [A],{REST[16:]}"),
        is_read=False,
        rig=w.TWO_COILS,
        tells="coil2_current_A  -3 A",
    ),
]
OF_HEADINGS = [
    Form("two_headers.csv", text(",,Position,,,Field,,\nTime,Current,x,y,z,Bx,By,Bz\ns,A,mm,mm,mm,uT,uT,uT")),
    Form("groups_with_units.csv", text("Time [s],Current [A],Position [mm],,,Field [uT],,\n,,x,y,z,x,y,z")),
    Form(
        "groups_over_units.csv",
        text("Time,Current,Position,,,Field,,\n[s],[A],x,y,z,x,y,z\ns,A,mm,mm,mm,uT,uT,uT"),
    ),
    Form(
        "latex.csv",
        text("$t$ [s],$I$ [A],$x$ [mm],$y$ [mm],$z$ [mm],$B_x$ [mT],$B_{y}$ [mT],B_{z} [mT]", w.MILLI),
    ),
    Form("din.txt", text("t/s\tI/A\tx/mm\ty/mm\tz/mm\tBx/mT\tBy/mT\tBz/mT", w.MILLI, "\t")),
    Form(
        "german.csv",
        text(
            "Zeit [s];Strom [A];Weg x [mm];Weg y [mm];Weg z [mm];Feld Bx [mT];Feld By [mT];Feld Bz [mT]",
            w.MILLI,
            ";",
            ",",
        ),
    ),
    Form(
        "french.csv",
        text(
            "Temps (s);Courant (A);X (mm);Y (mm);Z (mm);Champ X (mT);Champ Y (mT);Champ Z (mT)",
            w.MILLI,
            ";",
            ",",
        ),
    ),
    Form(
        "set_and_measured.csv",
        columns(
            "t_s,I_set (A),I_meas (A),x_set (mm),y_set (mm),z_set (mm),x_meas (mm),y_meas (mm),z_meas (mm),Bx (uT),By (uT),Bz (uT)",
            *(T, CURRENT + 1, CURRENT, X + 1, Y + 1, Z + 1, *TABLE.T[2:]),
        ),
        tells="Left out: I_set (A), x_set (mm)",
    ),
    Form(
        "inches.csv",
        text(
            "Time (s),Current (A),X (in),Y (in),Z (in),Bx (nT),By (nT),Bz (nT)",
            TABLE * [1, 1, *[1 / 25.4] * 3, *[1e3] * 3],
        ),
    ),
    Form(
        "steps.csv",
        text("Time (s),Current (A),X (steps),Y (mm),Z (mm),Bx (uT),By (uT),Bz (uT)"),
        False,
        answer=w.PLAIN,
        tells="'steps' is none of m, cm, mm, um, nm, in: convert the column",
    ),
    Form(
        "cylindrical.csv",
        text("t_s,I_A,r (mm),phi (deg),z (mm),Br (uT),Bphi (uT),Bz (uT)"),
        False,
        answer=w.PLAIN,
        tells="look cylindrical: convert them",
    ),
    Form(
        "a_row_for_each_component.csv",
        columns(
            "t_s,I_A,x_mm,y_mm,z_mm,axis,field_uT",
            *np.repeat(TABLE[:, :5], 3, 0).T,
            "xyz" * 60,
            TABLE[:, 5:].ravel(),
        ),
        False,
        answer=w.PLAIN,
        tells="a row must hold all components of a reading; 'axis'",
    ),
    Form(
        "exchanged.csv",
        lines(*map(",".join, zip(*(line.split(",") for line in w.LINES), strict=True))),
        False,
        answer=w.PLAIN,
        tells="exchange rows and columns",
    ),
]
