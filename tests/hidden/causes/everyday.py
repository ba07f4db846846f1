"""Flaws of ordinary laboratories that no list of coilcal holds, two for most links of the chain; only mixed sessions hide them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.causes.bending import moved, turned_about_flange
from tests.hidden.causes.surroundings import dipole_field, place_beyond_sensor, vector, with_source
from tests.hidden.coil import MU0, NODES, Block, blocks_of, circular_field
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction, sign
from tests.hidden.protocols import Array
from tests.hidden.scene import Scene

ROUNDING_M = 1e-9
LONG_MOVE = 0.6  # quantile of the moves one way, above which a step is lost
TOGGLES = 0.15  # of the moves


def compressor_dips(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A compressor on the same mains: while it runs the supply delivers the share `size` less; it runs 20 to 50 % of every 60 to 200 s."""
    period_s, duty = rng.uniform(60.0, 200.0), rng.uniform(0.2, 0.5)
    phase = (scene.schedule.time_s / period_s + rng.random()) % 1.0
    known = (Known("loss", size, "1"), Known("period_s", period_s, "s"), Known("duty", duty, "1"))
    current_A = np.where(phase < duty, 1.0 - size, 1.0) * scene.current_A
    return replace(scene, current_A=current_A), Truth("coil1", known)


def flexing_cable(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Strands of the coil's cable are broken: where the arm bends it, less current flows.

    The share `size` is missing at one end of the travel, none at the other, with the square of the way between.
    """
    along = direction(rng)
    way_m = scene.schedule.displacement_m @ along
    bend = ((way_m - way_m.min()) / np.ptp(way_m)) ** 2
    known = (Known("loss", size, "1"), *vector("along", along, "1"))
    return replace(scene, current_A=(1.0 - size * bend) * scene.current_A), Truth("coil1", known)


def tapered_former(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The moulded former has a draft: a loop of radius a has a (1 + taper u), u = -1 at the back face and +1 at the front."""
    taper = sign(rng) * size
    before, (whole,) = scene.coil_field, blocks_of(scene.winding)
    few = whole.reduced(NODES)
    stretch = 1.0 + taper * (2.0 * few.heights_m / scene.winding.length_m + 1.0)

    def slices(factors: Array) -> list[Block]:
        loops = zip(few.heights_m, few.turns, factors, strict=True)
        return [Block(np.array([z]), np.array([n]), few.radii_m * f, few.layers) for z, n, f in loops]

    conical, straight = circular_field(slices(stretch)), circular_field(slices(np.ones_like(stretch)))
    made = replace(
        scene, coil_field=lambda points_m: before(points_m) + conical(points_m) - straight(points_m)
    )
    return made, Truth("coil1", (Known("taper", taper, "1"),))


def warm_short(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Insulation gives way in the warm: while the winding is warmer than a limit, the share `size` of its innermost layer is bridged.

    The limit lies where 30 to 70 % of the readings are cooler.
    """
    warming = scene.schedule.coil_warming
    is_bridged = warming > np.quantile(warming, rng.uniform(0.3, 0.7))
    (whole,) = blocks_of(scene.winding)
    innermost = replace(whole, radii_m=whole.radii_m[-1:], layers=whole.layers[-1:])
    layer = circular_field((innermost,))

    def missing(now: Scene, points_m: Array) -> Array:
        bridged_A = -size * is_bridged * now.current_A
        return np.asarray(bridged_A[:, None] * now.from_coil_axes(layer(now.in_coil_frame(points_m))))

    return with_source(scene, missing), Truth("coil1", (Known("share", size, "1"),))


def remembering_bolt(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A hardened bolt near the sensor stays magnetised along its shank, in proportion to the strongest field that the coil ever made there.

    Its moment is that of a soft sphere of cubed radius `size` in that field; before the first reading it has none.
    """
    place_m, shank = place_beyond_sensor(rng), direction(rng)

    def field(now: Scene, points_m: Array) -> Array:
        along_T = now.coil_field_at(np.broadcast_to(place_m, points_m.shape)) @ shank
        moment_A_m2 = 4.0 * np.pi * size / MU0 * strongest_so_far(along_T)
        return dipole_field(points_m - place_m, moment_A_m2[:, None] * shank)

    known = (*vector("position", place_m, "m"), *vector("shank", shank, "1"))
    return with_source(scene, field), Truth("room", known)


def strongest_so_far(values: Array) -> Array:
    """The entry of largest magnitude up to and with each."""
    is_record = np.abs(values) >= np.maximum.accumulate(np.abs(values))
    return values[np.maximum.accumulate(np.where(is_record, np.arange(len(values)), 0))]


def neighbour_ramp(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The laboratory next door ramps its magnet up, holds it and ramps it down: a uniform field rises to `size`, stays and falls.

    Each ramp takes 15 to 30 % of the session, the whole 60 to 90 %.
    """
    time_s, field_T = scene.schedule.time_s, size * direction(rng)
    whole_s, ramp_s = rng.uniform(0.6, 0.9) * time_s[-1], rng.uniform(0.15, 0.3) * time_s[-1]
    begin_s = rng.uniform(0.05, 0.95) * (time_s[-1] - whole_s)
    since_s = time_s - begin_s
    ramped_T = np.clip(np.minimum(since_s, whole_s - since_s) / ramp_s, 0.0, 1.0)[:, None] * field_T
    known = (Known("begin_s", begin_s, "s"), Known("ramp_s", ramp_s, "s"), Known("whole_s", whole_s, "s"))
    return with_source(scene, lambda *_: ramped_T), Truth("room", (*known, *vector("field", field_T, "T")))


def lost_steps(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A motor without encoder loses a step of `size` in every long move one way and none in others: losses add up.

    Long are the moves above 60 % of those that way, which is any direction.
    """
    along = direction(rng)
    move_m = np.diff(scene.schedule.displacement_m @ along, prepend=scene.schedule.displacement_m[0] @ along)
    limit_m = np.quantile(move_m[move_m > ROUNDING_M], LONG_MOVE) + ROUNDING_M  # moves of a raster are alike
    lost_m = size * np.cumsum(move_m > limit_m)
    known = (Known("step_m", size, "m"), *vector("along", along, "1"))
    return moved(scene, -lost_m[:, None] * along), Truth("arm1", known)


def frame_breathing(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The air conditioner warms and cools the mover's frame, once in 80 to 300 s.

    Distances from the first reading's place swing by the share `size`.
    """
    period_s, phase_rad = rng.uniform(80.0, 300.0), rng.uniform(-np.pi, np.pi)
    swing = size * np.sin(2.0 * np.pi * scene.schedule.time_s / period_s + phase_rad)
    known = (
        Known("share", size, "1"),
        Known("period_s", period_s, "s"),
        Known("phase_rad", phase_rad, "rad"),
    )
    way_m = scene.displacement_m - scene.displacement_m[0]
    return moved(scene, swing[:, None] * way_m), Truth("arm1", known)


def warm_mount(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The mount is of plastic and gives way to the coil's heat: the coil tips about the flange, 7 cm behind it.

    By `size` when it is as warm as its largest current would make it in the end, and in proportion below.
    """
    turn_rad = size * direction(rng)
    turn = Rotation.from_rotvec(scene.schedule.coil_warming[:, None] * turn_rad).as_matrix()
    return turned_about_flange(scene, turn), Truth("coil1", vector("turn", turn_rad, "rad"))


def toggling_probe(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A sensor sits loosely in its holder: jolts, at one in seven of the moves, throw it `size` to and fro between two places."""
    is_its, name = afflicted_sensor(scene, rng)
    shift_m = size * direction(rng)
    is_move = np.diff(scene.schedule.visit, prepend=scene.schedule.visit[0]) != 0
    is_jolt = is_move & (rng.random(len(is_move)) < TOGGLES)
    is_away = (np.cumsum(is_jolt) % 2 == 1) & is_its
    place_m = scene.sensor_position_m + is_away[:, None] * shift_m
    return replace(scene, sensor_position_m=place_m), Truth(name, vector("shift", shift_m, "m"))


def warmup_gain(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A sensor's amplifier was switched on at the first reading: its gain is off by the share `size`.

    It settles in 5 to 30 % of the session.
    """
    is_its, name = afflicted_sensor(scene, rng)
    excess, time_s = sign(rng) * size, scene.schedule.time_s
    tau_s = rng.uniform(0.05, 0.3) * time_s[-1]
    gain = 1.0 + excess * is_its * np.exp(-(time_s - time_s[0]) / tau_s)
    known = (Known("excess", excess, "1"), Known("tau_s", tau_s, "s"))
    return replace(scene, field_T=gain[:, None] * scene.readings_T), Truth(name, known)


def autozero_jumps(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """An instrument zeroes itself 6 to 14 times in a session, badly: each time each axis gets a zero of its own, normal with `size`.

    The zero of the start is right.
    """
    is_its, name = afflicted_sensor(scene, rng)
    n_zeros = int(rng.integers(6, 15))
    time_s = scene.schedule.time_s
    which = np.floor((n_zeros + 1) * (time_s - time_s[0]) / (time_s[-1] - time_s[0] + 1.0)).astype(int)
    zeros_T = size * np.concatenate([np.zeros((1, 3)), rng.normal(size=(n_zeros, 3))])
    made = replace(scene, field_T=scene.readings_T + is_its[:, None] * zeros_T[which])
    return made, Truth(name, (Known("sd_T", size, "T"), Known("zeros", float(n_zeros), "1")))


CAUSES = (
    Cause("compressor_dips", Stage.SUPPLY, "1", 0.05, compressor_dips, freedom=3),
    Cause("flexing_cable", Stage.SUPPLY, "1", 0.1, flexing_cable, freedom=3),
    Cause("tapered_former", Stage.WINDING, "1", 0.1, tapered_former),
    Cause("warm_short", Stage.SURROUNDINGS, "1", 1.0, warm_short),
    Cause("remembering_bolt", Stage.SURROUNDINGS, "m3", 2.7e-5, remembering_bolt, freedom=5),
    Cause("neighbour_ramp", Stage.SURROUNDINGS, "T", 500e-6, neighbour_ramp, freedom=6),
    Cause("lost_steps", Stage.ROBOT, "m", 2e-4, lost_steps, freedom=3),
    Cause("frame_breathing", Stage.ROBOT, "1", 0.02, frame_breathing, freedom=2),
    Cause("warm_mount", Stage.ROBOT, "rad", 0.03, warm_mount, freedom=3),
    Cause("toggling_probe", Stage.ROBOT, "m", 1e-3, toggling_probe, freedom=3),
    Cause("warmup_gain", Stage.SENSOR, "1", 0.05, warmup_gain, freedom=2),
    Cause("autozero_jumps", Stage.SENSOR, "T", 300e-6, autozero_jumps, freedom=3),
)
