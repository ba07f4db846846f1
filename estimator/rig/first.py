"""Bodies and numbers of a first rig without a file: one round coil, one sensor, and a stage that carries one of them.

Its priors are as wide as a ruler and a maker's note leave the numbers, as in the file that `coilcal init` writes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from estimator.errors import InvalidInput
from estimator.rig.bodies import POSE_KEYS, Coil, MotionKind, Mover, Sensor
from estimator.rig.parameters import LogNormal, Normal, Parameter, Tie

PLACE_SD_M = 3e-3  # of a place that was measured with a ruler
TILT_SD_RAD = math.radians(2.0)  # of a mount that was set by eye
MOUNT_SD_RAD = math.radians(0.6)  # between the axes of a stage and what is screwed to it
RELATIVE_SD = 0.05  # of a radius that was measured with a caliper over tape and varnish
ROOM_SD_T = ZERO_SD_T = 50e-6  # of a component of the Earth's field, and of the zero of a Hall sensor
GAIN_SD = 0.01  # of a sensor that was not calibrated
NOISE_RELATIVE_SD = 0.5


class FirstRig(NamedTuple):
    """What a first rig consists of; effects are given by name and place."""

    coil: Coil
    sensor: Sensor
    mover: Mover
    parameters: dict[str, Parameter]
    effects: tuple[tuple[str, str], ...]


def first_rig(
    radius_m: float,
    axial_loops: float,
    radial_loops: float,
    wire_radius_m: float,
    distance_m: float,
    noise_T: float,
    moves: str,
) -> FirstRig:
    """See `Rig.coil`."""
    if moves not in ("coil", "sensor"):
        raise InvalidInput(f"moves must be 'coil' or 'sensor'; received {moves!r}")
    for key, value in (("distance_m", distance_m), ("noise_T", noise_T)):
        if not 0.0 < value < math.inf:
            raise InvalidInput(f"{key} must be > 0; received {value}")
    is_coil_moved = moves == "coil"
    coil, sensor = (
        Coil("coil1", "stage" if is_coil_moved else None),
        Sensor("hall", None if is_coil_moved else "stage"),
    )
    parameters = [
        *_winding(coil.name, radius_m, axial_loops, radial_loops, wire_radius_m),
        *(_carried("coil1", "coil", -distance_m) if is_coil_moved else _pose("coil1.world_from_coil")),
        Parameter("hall.noise_T", "T", noise_T, LogNormal(noise_T, NOISE_RELATIVE_SD), is_positive=True),
        Parameter("hall.gain", "1", 1.0, Normal(1.0, GAIN_SD)),
        *(_pose("hall.world_from_sensor") if is_coil_moved else _carried("hall", "sensor", distance_m)),
    ]
    effects = {("background_field", "room"): ROOM_SD_T, ("sensor_offset", "hall"): ZERO_SD_T}
    for (effect, place), sd_T in effects.items():
        parameters += [
            Parameter(f"{effect}[{place}].{axis}_T", "T", 0.0, Normal(0.0, sd_T)) for axis in "xyz"
        ]
    stage = Mover("stage", MotionKind.DISPLACEMENT)
    return FirstRig(coil, sensor, stage, {each.name: each for each in parameters}, tuple(effects))


def _winding(
    coil: str, radius_m: float, axial_loops: float, radial_loops: float, wire_radius_m: float
) -> Iterator[Parameter]:
    for key, size_m in (("radius_m", radius_m), ("wire_radius_m", wire_radius_m)):
        if not 0.0 < size_m < math.inf:
            raise InvalidInput(f"{key} must be > 0; received {size_m}")
        yield Parameter(
            f"{coil}.{key}", "m", size_m, Normal(size_m, RELATIVE_SD * size_m, lower=0.0), is_positive=True
        )
    for key in ("axial_pitch_m", "radial_pitch_m"):
        yield Parameter(f"{coil}.{key}", "m", 0.0, tie=Tie(f"{coil}.wire_radius_m", 2.0), is_positive=True)
    for key, loops, least_sd in (("axial_loops", axial_loops, 1.0), ("radial_loops", radial_loops, 0.5)):
        prior = Normal(loops, max(least_sd, RELATIVE_SD * loops), lower=1.0)
        yield Parameter(f"{coil}.{key}", "1", loops, prior, is_positive=True, is_count=True)
    yield Parameter(f"{coil}.current_gain", "1", 1.0)


def _carried(body: str, kind: str, z_m: float) -> Iterator[Parameter]:
    """Place of a body at zero displacement, and its turn on the stage."""
    place = {"x_m": PLACE_SD_M, "y_m": PLACE_SD_M, "z_m": PLACE_SD_M}
    tilt = dict.fromkeys(("tilt_x_rad", "tilt_y_rad"), TILT_SD_RAD)
    yield from _pose(f"{body}.world_from_{kind}0", {**place, **tilt}, z_m)
    turns = ("tilt_x_rad", "tilt_y_rad", *(["spin_rad"] if kind == "sensor" else []))
    yield from _pose(f"{body}.flange_from_{kind}", dict.fromkeys(turns, MOUNT_SD_RAD))


def _pose(pose: str, sds: Mapping[str, float] | None = None, z_m: float = 0.0) -> Iterator[Parameter]:
    for key in POSE_KEYS:
        value, sd = z_m if key == "z_m" else 0.0, (sds or {}).get(key)
        yield Parameter(
            f"{pose}.{key}",
            "m" if key.endswith("_m") else "rad",
            value,
            None if sd is None else Normal(value, sd),
        )


def thickness_at_most(wire_radius: float, radial_loops: float) -> float:
    """Largest thickness of a winding's layers that the priors of a first rig allow, in the unit of the wire's radius.

    Examples:
        >>> thickness_at_most(0.5, 10.0) > 10.0
        True
    """
    return 2.0 * wire_radius * radial_loops * (1.0 + 2.0 * RELATIVE_SD)
