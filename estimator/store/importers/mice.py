"""Imports maps of the MICE spectrometer solenoids: six Hall probes on a disc that is stepped along z and rotated.

Files `*_polarCoordinates.dat` of the public repository JoeLanglands/MICE-MagneticFieldMapping (MIT licence), folder micemag/data/SSU.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

from jaxtyping import Float, Int

from estimator.errors import InvalidInput, quoted
from estimator.rig.rig import Rig
from estimator.store.importers.common import (
    current_by_coil,
    map_observations,
    pose_mover,
    read_lines,
    read_numbers,
)
from estimator.store.session import Session
from estimator.tensors import Tensor, torch

NOMINAL_CURRENT_A = 30.0
COLUMNS = ("z", "r", "phi", "Br", "Bphi", "Bz", "B", "probeID", "Date", "Time")
LARGEST_MISMATCH_M = 1e-3


def read_mice(path: Path, rig: Rig, currents_A: Mapping[str, float] | None = None) -> Session:
    """Read one map.

    The six probes sit at different azimuths of the disc. The file's phi is the azimuth of the probe: disc angle plus the azimuth at
    which the rig file mounts that probe. The disc angle at an instant follows from its off-axis probes, which must agree.

    The sensor axes are radial, azimuthal and axial, so an off-axis row holds the sensor's components directly. Rows at r = 0 have
    phi = 0 at every disc angle: their Br and Bphi are components along x and y of the mapper, rotated from a sensor that turns with
    the disc. (In run 07 the transverse field at probe 0 far from the coil, 0.53 mT, turns with the disc angle; of the four ways to
    read it only this one fits the coil, 0.23 mT against 0.5 mT and more.) They are rotated back by the disc angle.

    Args:
        path: A `*_polarCoordinates.dat` file.
        rig: Must have one pose mover, the disc, which carries the sensors probe0 to probe5, as in configs/mice_ssu_m1.yaml.
        currents_A: Current of each coil; 30 A in every coil if not given.
    Raises:
        InvalidInput: The file has another format, or a probe is more than 1 mm from its mount in the rig file.
    """
    header = read_lines(path)[:1]
    if not header or not header[0].startswith("#") or any(name not in header[0] for name in COLUMNS):
        raise InvalidInput(f"{path} must begin with a # line that names {', '.join(COLUMNS)}; it does not")
    table = read_numbers(path)
    if table.shape[1] != len(COLUMNS):
        raise InvalidInput(f"{path} must have {len(COLUMNS)} columns; it has {table.shape[1]}")
    time_s = _seconds(table[:, 8:10], path)
    sensor = _sensor(table[:, 7], rig, path)
    order = sorted(range(len(table)), key=lambda row: (float(time_s[row]), int(sensor[row])))
    time_s, sensor, table = time_s[order], sensor[order], table[order]
    angle_rad = _disc_angle(table, time_s, sensor, rig, path)
    pose = torch.zeros(len(table), 6, dtype=torch.float64)
    pose[:, 2], pose[:, 5] = table[:, 0], angle_rad.nan_to_num(0.0)
    currents = dict.fromkeys((coil.name for coil in rig.coils), NOMINAL_CURRENT_A)
    observations = map_observations(
        rig,
        current_by_coil(rig, currents_A or currents),
        pose,
        _field(table, angle_rad),
        time_s=time_s - time_s[0],
        sensor=sensor,
    )
    source = f"MICE map {path.name}; rows sorted by time, one instant per second holds all probes"
    return Session(rig, observations, source)


def _seconds(date_and_time: Float[Tensor, "row 2"], path: Path) -> Float[Tensor, " row"]:
    """Seconds since an arbitrary instant, from numbers DDMMYYYY and HHMMSS without their leading zeros."""
    seconds = []
    for date, time in date_and_time.tolist():
        text = f"{date:08.0f} {time:06.0f}"
        try:
            seconds.append((datetime.strptime(text, "%d%m%Y %H%M%S") - datetime(2000, 1, 1)).total_seconds())
        except ValueError as error:
            raise InvalidInput(
                f"date and time must read DDMMYYYY HHMMSS; received {quoted(text)} ({path})"
            ) from error
    return torch.tensor(seconds, dtype=torch.float64)


def _sensor(probe_id: Float[Tensor, " row"], rig: Rig, path: Path) -> Int[Tensor, " row"]:
    """Index of each row's probe among the rig's sensors."""
    index = {sensor.name: i for i, sensor in enumerate(rig.sensors)}
    names = [f"probe{number:g}" for number in probe_id.tolist()]
    unknown = next((name for name in names if name not in index), None)
    if unknown is not None:
        raise InvalidInput(
            f"probes must be sensors of rig {rig.name!r} ({', '.join(index)}); received {unknown} ({path})"
        )
    return torch.tensor([index[name] for name in names])


def _disc_angle(
    table: Float[Tensor, "row 10"],
    time_s: Float[Tensor, " row"],
    sensor: Int[Tensor, " row"],
    rig: Rig,
    path: Path,
) -> Float[Tensor, " row"]:
    """Angle of the disc at each row's instant; NaN if only the probe on the axis was read."""
    pose_mover(rig)
    values = rig.nominal_values()
    mounts = [
        (values[f"{s.name}.flange_from_sensor.x_m"], values[f"{s.name}.flange_from_sensor.y_m"])
        for s in rig.sensors
    ]
    angle_at: dict[float, float] = {}
    for row, (time, i) in enumerate(zip(time_s.tolist(), sensor.tolist(), strict=True)):
        z_m, radius_m, phi_deg = table[row, :3].tolist()
        mount_radius_m, name = math.hypot(*mounts[i]), rig.sensors[i].name
        if abs(radius_m - mount_radius_m) > LARGEST_MISMATCH_M:
            rule = f"{name} must be at r = {mount_radius_m:g} m, where rig {rig.name!r} mounts it"
            raise InvalidInput(f"{rule}; received {radius_m:g} at z = {z_m:g} m ({path})")
        if radius_m > LARGEST_MISMATCH_M:
            angle_rad = math.radians(phi_deg) - math.atan2(mounts[i][1], mounts[i][0])
            off_rad = math.remainder(angle_rad - angle_at.setdefault(time, angle_rad % math.tau), math.tau)
            if abs(off_rad) * radius_m > LARGEST_MISMATCH_M:
                rule = f"{name} must be at the azimuth at which rig {rig.name!r} mounts it"
                raise InvalidInput(
                    f"{rule}; it is {math.degrees(off_rad):.3g} deg off at z = {z_m:g} m ({path})"
                )
    return torch.tensor([angle_at.get(time, math.nan) for time in time_s.tolist()], dtype=torch.float64)


def _field(table: Float[Tensor, "row 10"], angle_rad: Float[Tensor, " row"]) -> Float[Tensor, "row 3"]:
    """Field components along the axes of each probe."""
    field_T = table[:, 3:6].clone()
    on_axis = table[:, 1] <= LARGEST_MISMATCH_M
    cosine, sine = torch.cos(angle_rad[on_axis]), torch.sin(angle_rad[on_axis])
    x_T, y_T = table[on_axis, 3], table[on_axis, 4]
    field_T[on_axis, 0] = cosine * x_T + sine * y_T
    field_T[on_axis, 1] = cosine * y_T - sine * x_T
    return field_T
