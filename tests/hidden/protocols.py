"""Two ways to measure one coil that a robot arm carries past fixed sensors: the paper's, and the one that splits more causes.

Nothing here knows of any flaw: a schedule is what the laboratory commands and what its clock and thermometers say. Positions are
displacements of the coil in the end-effector frame, relative to a reference in which the coil's front face looks at the room's
origin from `distance_m` (Osinde et al., eq 18-22).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]

PROTOCOLS = ("paper", "recommended")
MOTIONS = ("displacement", "pose", "UR3", "UR3e")  # what the arm writes down
CARTESIAN = MOTIONS[:2]
DWELL_S = 2.0
ROOM_C = 25.0


@dataclass(frozen=True)
class SensorPlace:
    """Where a three-axis sensor is fixed in the room, known exactly: position and rotation vector world_from_sensor."""

    name: str
    position_m: tuple[float, float, float]
    rotation_vector_rad: tuple[float, float, float]


@dataclass(frozen=True)
class Schedule:
    """A session as it was commanded; one row is one reading of one sensor.

    Attributes:
        protocol: One of `PROTOCOLS`.
        distance_m: Nominal distance of the coil's front face from the room's origin at the reference.
        visit: Number of the stop at a pose; readings of one stop share it.
        coil_warming: Rise of the coil's temperature above the room's, as a share of the final rise at the largest current.
        steady_rise_K: That final rise.
        coil_temperature_C, sensor_temperature_C: True temperatures; `has_temperature` says whether the record shows them.
        motion: One of `MOTIONS`; but for a displacement, `displacement_m` is the commanded place of the flange in the arm's base.
        turn: Commanded rotation base_from_flange, reading by matrix; None for displacements.
        joint_rad: Commanded joint angles, where they are written down.
    """

    protocol: str
    distance_m: float
    sensors: tuple[SensorPlace, ...]
    time_s: Array
    sensor: npt.NDArray[np.int64]
    displacement_m: Array
    current_A: Array
    visit: npt.NDArray[np.int64]
    is_validation: npt.NDArray[np.bool_]
    warming_time_s: float
    steady_rise_K: float
    coil_warming: Array
    coil_temperature_C: Array
    sensor_temperature_C: Array
    has_temperature: bool
    motion: str = "displacement"
    turn: Array | None = None
    joint_rad: Array | None = None

    def __len__(self) -> int:
        return len(self.time_s)


def draw_schedule(protocol: str, rng: np.random.Generator) -> Schedule:
    """Draw current, distance, grid, order and temperatures of a session.

    Raises:
        ValueError: The protocol is neither `paper` nor `recommended`.
    """
    if protocol not in PROTOCOLS:
        raise ValueError(f"protocol must be one of {', '.join(PROTOCOLS)}; received {protocol!r}")
    return _paper(rng) if protocol == "paper" else _recommended(rng)


def _paper(rng: np.random.Generator) -> Schedule:
    """5 x 5 x 5 places in raster order at one current; a fifth of the grid or 31 places after it serve as validation."""
    places_m = _grid(rng)
    if rng.random() < 0.5:
        is_validation = _blocks(np.arange(125), 5, rng)
    else:
        extra_m = rng.uniform(places_m.min(axis=0), places_m.max(axis=0), (31, 3))
        places_m = np.concatenate([places_m, extra_m])
        is_validation = np.arange(len(places_m)) >= 125
    n = len(places_m)
    current_A = np.full(n, rng.uniform(2.5, 3.5))
    visit = np.arange(n)
    sensors = (SensorPlace("hall", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),)
    return _schedule(
        "paper", sensors, np.zeros(n, dtype=np.int64), places_m, current_A, visit, is_validation, rng
    )


def _recommended(rng: np.random.Generator) -> Schedule:
    """125 places in random order, two of {+I, -I, I/2, 0} at each, one of two sensors; two places are visited three times at all four currents."""
    places_m = _grid(rng)
    order = rng.permutation(125)
    revisited = rng.choice(125, 2, replace=False)
    stops = [*revisited, *order[:62], *revisited, *order[62:], *revisited]
    is_long = np.zeros(len(stops), dtype=bool)
    is_long[[0, 1, 64, 65, 129, 130]] = True
    largest_A = rng.uniform(2.5, 3.5)
    levels_A = largest_A * np.array([1.0, -1.0, 0.5, 0.0])
    place: list[int] = []
    sensor: list[int] = []
    level_A: list[float] = []
    visit: list[int] = []
    for number, stop in enumerate(stops):
        if is_long[number]:
            chosen = rng.permutation(4)
            mine = [number % 2, number % 2, (number + 1) % 2, (number + 1) % 2]
        else:
            chosen = rng.choice(4, 2, replace=False, p=[0.35, 0.35, 0.18, 0.12])
            mine = [int(rng.integers(2))] * 2
        place += [int(stop)] * len(chosen)
        sensor += mine
        level_A += list(levels_A[chosen])
        visit += [number] * len(chosen)
    x_m, y_m, z_m = (float(reach_m * rng.uniform(-1.0, 1.0)) for reach_m in (0.012, 0.012, 0.003))
    rx_rad, ry_rad, rz_rad = Rotation.from_quat(rng.normal(size=4)).as_rotvec().tolist()
    sensors = (
        SensorPlace("hall", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        SensorPlace("hall_turned", (x_m, y_m, z_m), (rx_rad, ry_rad, rz_rad)),
    )
    stop_of = np.array(visit)
    return _schedule(
        "recommended",
        sensors,
        np.array(sensor),
        places_m[place],
        np.array(level_A),
        stop_of,
        _blocks(stop_of, 4, rng),
        rng,
    )


def _grid(rng: np.random.Generator) -> Array:
    """5 x 5 x 5 places over about 100 x 100 x 50 mm, each off its node by up to 1 mm; rows to and fro, or always forward."""
    half_m = np.array([0.05, 0.05, 0.025]) * rng.uniform(0.9, 1.0)
    steps = np.linspace(-1.0, 1.0, 5)
    is_to_and_fro = rng.random() < 0.5
    rows = []
    for i in range(5):
        for j in range(5):
            backwards = is_to_and_fro and (5 * i + j) % 2 == 1
            across = steps[::-1][j] if is_to_and_fro and i % 2 == 1 else steps[j]
            along = steps[::-1] if backwards else steps
            rows.append(np.stack([np.full(5, steps[i]), np.full(5, across), along], axis=1))
    return np.concatenate(rows) * half_m + rng.uniform(-1e-3, 1e-3, (125, 3)) * rng.uniform()


def _blocks(stop: npt.NDArray[np.int64], length: int, rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """About a fifth of the stops, as blocks of `length` stops in a row."""
    block = stop // length
    n_blocks = int(block.max()) + 1
    chosen: npt.NDArray[np.bool_] = np.isin(block, rng.choice(n_blocks, round(n_blocks / 5), replace=False))
    return chosen


def _schedule(
    protocol: str,
    sensors: tuple[SensorPlace, ...],
    sensor: npt.NDArray[np.int64],
    displacement_m: Array,
    current_A: Array,
    visit: npt.NDArray[np.int64],
    is_validation: npt.NDArray[np.bool_],
    rng: np.random.Generator,
) -> Schedule:
    """Add clock and temperatures: the room drifts by half a kelvin, the sensor by 1.5 to 4 K, the coil warms with the square of its current."""
    time_s = np.asarray(DWELL_S * np.arange(1.0, len(sensor) + 1.0))
    warming_time_s = float(np.exp(rng.uniform(np.log(60.0), np.log(600.0))))
    rise_K = rng.uniform(3.0, 8.0)
    warming = _warming(current_A / np.abs(current_A).max(), warming_time_s)
    room_C = ROOM_C + 0.25 * _slow(time_s, rng)
    return Schedule(
        protocol,
        rng.uniform(0.042, 0.056),
        sensors,
        time_s,
        sensor,
        displacement_m,
        current_A,
        visit,
        is_validation,
        warming_time_s,
        rise_K,
        warming,
        room_C + rise_K * warming,
        ROOM_C + rng.uniform(1.5, 4.0) * _slow(time_s, rng),
        has_temperature=protocol == "recommended",
    )


def _warming(relative_current: Array, warming_time_s: float) -> Array:
    """First-order warming: each dwell closes the gap to I^2 by 1 - exp(-dwell / warming time); the coil starts at the room's temperature."""
    share = 1.0 - np.exp(-DWELL_S / warming_time_s)
    warming = np.zeros(len(relative_current))
    state = 0.0
    for k, current in enumerate(relative_current):
        state += (current**2 - state) * share
        warming[k] = state
    return warming


def _slow(time_s: Array, rng: np.random.Generator) -> Array:
    """A slow wave without mean whose largest deviation is 1."""
    phase = time_s / time_s[-1]
    wave = rng.normal() * phase
    for periods in rng.uniform(0.5, 1.5, 2):
        wave = wave + rng.normal() * np.sin(2.0 * np.pi * (periods * phase + rng.random()))
    wave = wave - wave.mean()
    return np.asarray(wave / np.abs(wave).max())
