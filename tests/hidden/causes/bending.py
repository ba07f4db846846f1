"""Flaws of mechanics: what carries coil and sensor bends, warms, creeps and swings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.causes.robot import AXES, last_move
from tests.hidden.causes.surroundings import vector
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction, sign
from tests.hidden.protocols import CARTESIAN, Array
from tests.hidden.scene import Scene
from tests.hidden.stated_rig import MOUNT_M

REACH_M = 0.5
DOWN = np.array([0.0, 0.0, -1.0])


def gravity_droop(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The arm sags with the square of its level reach from the shoulder: by `size` at half a metre, less what it did at the first reading.

    A displacement's axes are those of a tool that points anywhere, 0.3 to 0.5 m from the shoulder.
    """
    down, shoulder_m = direction(rng), rng.uniform(0.3, 0.5) * direction(rng)
    if scene.arm is not None:
        down, shoulder_m = DOWN, np.zeros(3)
    reach_m = np.linalg.norm(np.cross(scene.displacement_m - shoulder_m, down), axis=1)
    sag_m = size * (reach_m**2 - reach_m[0] ** 2) / REACH_M**2
    return moved(scene, sag_m[:, None] * down), Truth("arm1", (Known("sag_m", size, "m"),))


def screw_pitch_error(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """One axis runs fast and slow once per period of its screw or rack, 3 to 30 mm."""
    axis, period_m, phase_rad = int(rng.integers(3)), rng.uniform(3e-3, 30e-3), rng.uniform(-np.pi, np.pi)
    error_m = size * np.sin(2.0 * np.pi * scene.displacement_m[:, axis] / period_m + phase_rad)
    known = (Known(f"amplitude_{AXES[axis]}_m", size, "m"), Known("period_m", period_m, "m"))
    return moved(scene, error_m[:, None] * np.eye(3)[axis]), Truth("arm1", known)


def arm_warming(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The arm grows by `size` as its motors warm it, of first order in a tenth to a half of the session."""
    time_s, along = scene.schedule.time_s, direction(rng)
    tau_s = rng.uniform(0.1, 0.5) * time_s[-1]
    grown = size * (1.0 - np.exp(-time_s / tau_s))
    known = (Known("tau_s", tau_s, "s"), *vector("growth", size * along, "m"))
    return moved(scene, grown[:, None] * along), Truth("arm1", known)


def overshoot(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Read too early, the arm still swings: the first reading of a stop is off by a share of the move that led there."""
    share = sign(rng) * size
    is_first = np.diff(scene.schedule.visit, prepend=-1) != 0
    error_m = share * is_first[:, None] * last_move(scene.schedule.displacement_m)
    return moved(scene, error_m), Truth("arm1", (Known("share", share, "1"),))


def cable_pull(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The coil's cable tightens towards one side of the travel and turns the mount, with the square of the way there; `size` at the far end."""
    axis, along = direction(rng), direction(rng)
    way_m = scene.schedule.displacement_m @ along
    angle_rad = size * ((way_m - way_m.min()) / np.ptp(way_m)) ** 2
    turn = Rotation.from_rotvec(angle_rad[:, None] * axis).as_matrix()
    before = np.broadcast_to(np.eye(3), turn.shape) if scene.turn is None else scene.turn
    return replace(scene, turn=before @ turn), Truth("arm1", vector("turn", size * axis, "rad"))


def table_sag(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The sensors' table tips once the coil is far out to one side: `size` at the far end, nothing on the near two thirds of the travel."""
    along, down = direction(rng), direction(rng)
    way_m = scene.coil_origin_m() @ along
    share = (way_m - way_m.min()) / np.ptp(way_m)
    shift_m = size * np.maximum(0.0, 3.0 * share - 2.0)[:, None] * down
    known = vector("sag", size * down, "m")
    return replace(scene, sensor_position_m=scene.sensor_position_m + shift_m), Truth("room", known)


def creeping_clamp(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A sensor turns in its clamp, fast at first and ever slower: by `size` in all, with the logarithm of time."""
    is_its, name = afflicted_sensor(scene, rng)
    axis, time_s = direction(rng), scene.schedule.time_s
    start_s = rng.uniform(0.02, 0.2) * time_s[-1]
    angle_rad = size * is_its * np.log1p(time_s / start_s) / np.log1p(time_s[-1] / start_s)
    turn = Rotation.from_rotvec(angle_rad[:, None] * axis).as_matrix()
    return replace(scene, world_from_sensor=scene.world_from_sensor @ turn), Truth(
        name, vector("turn", size * axis, "rad")
    )


def winding_creep(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The warm winding slides along its former: by `size` when it is as warm as its largest current would make it in the end."""
    slide_m = sign(rng) * size
    along = scene.flange_from_coil[:, 2] if scene.turn is None else scene.turn @ scene.flange_from_coil[:, 2]
    return moved(scene, slide_m * scene.schedule.coil_warming[:, None] * along), Truth(
        "coil1", (Known("slide_m", slide_m, "m"),)
    )


def moved(scene: Scene, error_m: Array) -> Scene:
    """The arm misses its targets by so much, along the axes of its displacements."""
    return replace(scene, displacement_m=scene.displacement_m + error_m)


def turned_about_flange(scene: Scene, turn: Array) -> Scene:
    """The coil turns by so much, reading by matrix, about the flange that carries it."""
    before = np.broadcast_to(np.eye(3), turn.shape) if scene.turn is None else scene.turn
    made = replace(scene, turn=before @ turn)
    if scene.arm is None:  # the frame that displacements tell of is the coil's own, not the flange's
        made = moved(made, turn @ MOUNT_M - MOUNT_M)
    return made


CAUSES = (
    Cause("gravity_droop", Stage.ROBOT, "m", 5e-3, gravity_droop),
    Cause("screw_pitch_error", Stage.ROBOT, "m", 1e-3, screw_pitch_error, motions=CARTESIAN),
    Cause("arm_warming", Stage.ROBOT, "m", 2e-3, arm_warming, freedom=3),
    Cause("overshoot", Stage.ROBOT, "1", 0.05, overshoot),
    Cause("cable_pull", Stage.ROBOT, "rad", 0.05, cable_pull, freedom=5),
    Cause("table_sag", Stage.ROBOT, "m", 3e-3, table_sag, freedom=5),
    Cause("creeping_clamp", Stage.ROBOT, "rad", 0.05, creeping_clamp, freedom=4),
    Cause("winding_creep", Stage.ROBOT, "m", 2e-3, winding_creep),
)
