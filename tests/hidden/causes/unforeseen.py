"""Flaws that nobody who wrote or tuned a diagnosis had in mind: an exam of what it says of causes that no list holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.causes.bending import turned_about_flange
from tests.hidden.causes.outside import as_if_all_were
from tests.hidden.causes.sensor import REFERENCE_C
from tests.hidden.causes.surroundings import vector, with_source
from tests.hidden.causes.winding import FEW_LOOPS, STEPS
from tests.hidden.coil import Block, blocks_of, circular_field, closed_curve_field
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction, sign
from tests.hidden.protocols import Array
from tests.hidden.scene import Scene

LEAST_MOVE_M = 1e-6
LOWEST_PROBE_M = -0.05  # of a cage; below, the coil travels


def supply_hunting(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The supply's regulator hunts against the coil's inductance: the current swings by the share `size`, once in 0.3 to 30 s (aliased where short)."""
    period_s, phase_rad = float(np.exp(rng.uniform(np.log(0.3), np.log(30.0)))), rng.uniform(-np.pi, np.pi)
    swing = size * np.sin(2.0 * np.pi * scene.schedule.time_s / period_s + phase_rad)
    known = (Known("amplitude", size, "1"), Known("period_s", period_s, "s"))
    return replace(scene, current_A=(1.0 + swing) * scene.current_A), Truth(
        "coil1", (*known, Known("phase_rad", phase_rad, "rad"))
    )


def warped_former(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The printed former warped into a saddle: loops rise by `size` x (r / R_c)^2 x cos 2 (phi - angle), twice up and twice down on their way."""
    angle_rad = rng.uniform(0.0, np.pi)
    height_m, radius_m, weight = blocks_of(scene.winding)[0].reduced(FEW_LOOPS).loops()
    phi = 2.0 * np.pi * np.arange(STEPS) / STEPS
    twice = 2.0 * (phi - angle_rad)
    rise_m = (size * (radius_m / scene.winding.radius_m) ** 2)[:, None]
    flat_m = radius_m[:, None, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    along = (2.0 * np.pi / STEPS * weight)[:, None, None]
    slope = along * radius_m[:, None, None] * np.stack([-np.sin(phi), np.cos(phi)], axis=1)

    def curves(share: float) -> tuple[Array, Array]:
        level_m = height_m[:, None] + share * rise_m * np.cos(twice)
        climb = -2.0 * share * along[:, :, 0] * rise_m * np.sin(twice)
        return np.concatenate([flat_m, level_m[..., None]], axis=2), np.concatenate(
            [slope, climb[..., None]], axis=2
        )

    before = scene.coil_field

    def field(points_m: Array) -> Array:
        places, place = np.unique(points_m, axis=0, return_inverse=True)
        change = closed_curve_field(places, *curves(1.0)) - closed_curve_field(places, *curves(0.0))
        return np.asarray(before(points_m) + change[place.ravel()])

    known = (Known("rise_m", size, "m"), Known("angle_rad", angle_rad, "rad"))
    return replace(scene, coil_field=field), Truth("coil1", known)


def field_cancellation(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A field-cancelling cage takes the coil for a disturbance: it adds a uniform field, minus the share `size` of the coil's at its probe.

    The probe hangs 0.2 to 0.3 m from the room's origin, off the coil's way.
    """
    while True:
        probe_m = rng.uniform(0.2, 0.3) * direction(rng)
        if probe_m[2] > LOWEST_PROBE_M:
            break

    def field(now: Scene, points_m: Array) -> Array:
        return -size * now.coil_field_at(np.broadcast_to(probe_m, points_m.shape))

    known = (Known("share", size, "1"), *vector("probe", probe_m, "m"))
    return with_source(scene, field), Truth("room", known)


def coiled_cable(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """What one lead has to spare lies in a ring on the table: `size` turns, 12 to 20 cm across, carry the coil's current and stay in the room.

    Its middle is 12 to 18 cm from the room's origin, on the sensors' side.
    """
    radius_m, place_m = rng.uniform(0.06, 0.1), rng.uniform(0.12, 0.18) * direction(rng)
    place_m[2] = np.abs(place_m[2])
    rotation = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    ring = circular_field((Block(np.zeros(1), np.ones(1), np.array([radius_m]), np.ones(1)),))

    def field(now: Scene, points_m: Array) -> Array:
        per_turn = ring((points_m - place_m) @ rotation) @ rotation.T
        return np.asarray(size * now.current_A[:, None] * per_turn)

    known = (Known("turns", size, "1"), Known("radius_m", radius_m, "m"))
    place = (*vector("position", place_m, "m"), *vector("axis", rotation[:, 2], "1"))
    return with_source(scene, field), Truth("room", (*known, *place))


def rocking_mount(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A screw of the coil's mount is loose: the coil rocks about the flange, 7 cm behind it, by half of `size` to the side that the last move left.

    Moves count along one direction, and the coil turns about an axis across it; it begins as after a move forwards.
    """
    along = direction(rng)
    axis = np.cross(along, direction(rng))
    axis /= np.linalg.norm(axis)
    step_m = np.diff(scene.schedule.displacement_m @ along, prepend=-np.inf)
    side = np.where(np.abs(step_m) > LEAST_MOVE_M, np.sign(step_m), 0.0)
    last = np.maximum.accumulate(np.where(side != 0.0, np.arange(len(side)), 0))
    turn = Rotation.from_rotvec((0.5 * size * side[last])[:, None] * axis).as_matrix()
    known = (Known("play_rad", size, "rad"), *vector("axis", axis, "1"))
    return turned_about_flange(scene, turn), Truth("coil1", known)


def warm_stand(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The sensors' stand is of plastic and grows as it warms: all sensors shift by `size` per kelvin above 25 °C, at their own temperature."""
    growth_m_per_K = size * direction(rng)
    warm_K = scene.schedule.sensor_temperature_C - REFERENCE_C
    place_m = scene.sensor_position_m + warm_K[:, None] * growth_m_per_K
    return replace(scene, sensor_position_m=place_m), Truth("room", vector("growth", growth_m_per_K, "m/K"))


def coarse_range(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The instrument chooses its range: where a component exceeds the finer one, all three come from the coarser one and are off by the share `size`.

    The finer range ends where 30 to 70 % of the sensor's readings lie below.
    """
    is_its, name = afflicted_sensor(scene, rng)
    excess, share = sign(rng) * size, rng.uniform(0.3, 0.7)
    largest_T = np.abs(scene.readings_T).max(axis=1)
    range_T = float(np.quantile(largest_T[is_its], share))
    gain = 1.0 + excess * (is_its & (largest_T > range_T))
    known = (Known("excess", excess, "1"), Known("range_T", range_T, "T"))
    return replace(scene, field_T=gain[:, None] * scene.readings_T), Truth(name, known)


def clocks_apart(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Field and motion are logged by two computers whose clocks run apart, and joined by time: in the end `size` dwells too late, from none.

    A row's field is read off the straight line between that of its sensor at the reading before and at its own.
    """
    del rng
    time_s = scene.schedule.time_s
    late = size * (time_s - time_s[0]) / (time_s[-1] - time_s[0])
    joined = scene.readings_T.copy()
    for which in range(len(scene.schedule.sensors)):
        own = as_if_all_were(scene, which)
        before = np.concatenate([own[:1], own[:-1]])
        is_its = scene.schedule.sensor == which
        joined[is_its] += (late[:, None] * (before - own))[is_its]
    return replace(scene, field_T=joined), Truth("readings", (Known("late_in_the_end", size, "1"),))


CAUSES = (
    Cause("supply_hunting", Stage.SUPPLY, "1", 0.03, supply_hunting, freedom=2),
    Cause("warped_former", Stage.WINDING, "m", 2e-3, warped_former, freedom=2),
    Cause("field_cancellation", Stage.SURROUNDINGS, "1", 1.0, field_cancellation, freedom=4),
    Cause("coiled_cable", Stage.SURROUNDINGS, "1", 40.0, coiled_cable, freedom=3, protocols=("recommended",)),
    Cause("rocking_mount", Stage.ROBOT, "rad", 0.03, rocking_mount, freedom=3),
    Cause("warm_stand", Stage.ROBOT, "m/K", 2e-4, warm_stand, freedom=3),
    Cause("coarse_range", Stage.SENSOR, "1", 0.03, coarse_range),
    Cause("clocks_apart", Stage.SENSOR, "1", 0.1, clocks_apart),
)
