"""Maps of the MICE spectrometer solenoids: six Hall probes on a disc that is stepped along z and turned.

Files `*_polarCoordinates.dat` of the public repository JoeLanglands/MICE-MagneticFieldMapping (MIT licence), folder micemag/data/SSU.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch

from estimator.errors import InvalidInput
from estimator.rig import Rig
from estimator.store.importers.common import (
    current_by_coil,
    map_observations,
    read_lines,
    read_numbers,
)
from estimator.store.session import Session

NOMINAL_CURRENT_A = 30.0
COLUMNS = ("z", "r", "phi", "Br", "Bphi", "Bz", "B", "probeID", "Date", "Time")
LARGEST_MISMATCH_M = 1e-3


def read_mice(path: Path, rig: Rig, currents_A: Mapping[str, float] | None = None) -> Session:
    """Read one map.

    The six probes sit at different azimuths of the disc, and the file's phi is the azimuth of the probe: disc angle plus the azimuth
    at which the rig file mounts that probe. The disc angle of an instant follows from its off-axis probes, which must agree.

    The sensor axes are radial, azimuthal, axial, so that an off-axis row holds the sensor's components as they are. Rows at r = 0 have
    phi = 0 whatever the disc angle: their Br, Bphi are components along x and y of the mapper, turned there from a sensor that turns
    with the disc. (In run 07 the transverse part of probe 0 far from the coil, 0.53 mT, turns with the disc angle; of the four ways to
    read it only this one fits the coil, 0.23 mT against 0.5 mT and more.) They are turned back by the disc angle.

    Args:
        path: A `*_polarCoordinates.dat` file.
        rig: One pose mover, the disc; sensors probe0 to probe5 carried by it, as in configs/mice_ssu_m1.yaml.
        currents_A: Per coil; 30 A in every coil where not given.
    Raises:
        InvalidInput: Not such a file, or a probe is more than 1 mm from where the rig mounts it.
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
    pose[:, 2], pose[:, 5] = table[:, 0], angle_rad
    currents = dict.fromkeys((coil.name for coil in rig.coils), NOMINAL_CURRENT_A)
    observations = map_observations(
        rig,
        time_s - time_s[0],
        sensor,
        current_by_coil(rig, currents_A or currents),
        pose,
        _field(table, angle_rad),
    )
    source = f"MICE map {path.name}; rows sorted by time, one instant per second holds all probes"
    return Session(rig, observations, source)
