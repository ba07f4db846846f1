"""Flaws of robot and mounts: coil or sensor do not stand where the record says. `dt` is a displacement in the end-effector frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.causes.surroundings import vector
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction, sign
from tests.hidden.protocols import CARTESIAN, Array
from tests.hidden.scene import Scene

AXES = "xyz"


def mount_tilt(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The coil sits tilted in its mount: flange_from_coil is the rotation vector (tilt_x, tilt_y, 0) of length `size`.

    The coil's pose at the reference stays; a displacement dt moves it by flange_from_coil^T dt along its own axes (eq 22).
    """
    angle = rng.uniform(-np.pi, np.pi)
    tilt_rad = size * np.array([np.cos(angle), np.sin(angle), 0.0])
    truth = Truth("coil1", (Known("tilt_x_rad", tilt_rad[0], "rad"), Known("tilt_y_rad", tilt_rad[1], "rad")))
    return replace(scene, flange_from_coil=Rotation.from_rotvec(tilt_rad).as_matrix()), truth


def robot_scale(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """One axis of the robot moves (1 + scale) times as far as recorded."""
    axis, scale = int(rng.integers(3)), sign(rng) * size
    factor = np.ones(3)
    factor[axis] += scale
    truth = Truth("arm1", (Known(f"scale_{AXES[axis]}", scale, "1"),))
    return replace(scene, displacement_m=scene.displacement_m * factor), truth


def robot_shear(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Two axes are not at right angles: true dt_i = recorded dt_i + shear x recorded dt_j, for ij one of xy, xz, yz."""
    i, j = ((0, 1), (0, 2), (1, 2))[int(rng.integers(3))]
    shear = sign(rng) * size
    true_m = scene.displacement_m.copy()
    true_m[:, i] += shear * scene.displacement_m[:, j]
    return replace(scene, displacement_m=true_m), Truth(
        "arm1", (Known(f"shear_{AXES[i]}{AXES[j]}", shear, "1"),)
    )


def position_lag(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The arm stops `size` short of its target, along the last move; it begins at its first target."""
    del rng
    move_m = last_move(scene.schedule.displacement_m)
    length_m = np.linalg.norm(move_m, axis=1, keepdims=True)
    short_m = size * move_m / np.where(length_m > 0.0, length_m, 1.0)
    return replace(scene, displacement_m=scene.displacement_m - short_m), Truth(
        "arm1", (Known("lag_m", size, "m"),)
    )


def backlash(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """One axis has play: it stands half of `size` short of its target, on the side from which it came; at first from below."""
    axis = int(rng.integers(3))
    step = np.sign(np.diff(scene.schedule.displacement_m[:, axis], prepend=-np.inf))
    last = np.maximum.accumulate(np.where(step != 0.0, np.arange(len(step)), 0))
    true_m = scene.displacement_m.copy()
    true_m[:, axis] -= 0.5 * size * step[last]
    return replace(scene, displacement_m=true_m), Truth("arm1", (Known(f"play_{AXES[axis]}_m", size, "m"),))


def sensor_bumped(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """At one instant a sensor jumps by `size` in the room, without turning, and stays there."""
    is_its, name = afflicted_sensor(scene, rng)
    time_s = scene.schedule.time_s
    instant_s = rng.uniform(0.25, 0.6) * time_s[-1]
    shift_m = size * direction(rng)
    moved = (is_its & (time_s > instant_s))[:, None] * shift_m
    truth = Truth(name, (Known("instant_s", instant_s, "s"), *vector("shift", shift_m, "m")))
    return replace(scene, sensor_position_m=scene.sensor_position_m + moved), truth


def position_jitter(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """Every stop misses its target by an error of its own, normal with `size` along each axis."""
    visit = scene.schedule.visit
    error_m = size * rng.normal(size=(int(visit.max()) + 1, 3))[visit]
    return replace(scene, displacement_m=scene.displacement_m + error_m), Truth(
        "arm1", (Known("sd_m", size, "m"),)
    )


def last_move(target_m: Array) -> Array:
    """The last move that was one, at every reading; zero before the first."""
    step_m = np.diff(target_m, axis=0, prepend=target_m[:1])
    moved = np.linalg.norm(step_m, axis=1) > 0.0
    return np.asarray(step_m[np.maximum.accumulate(np.where(moved, np.arange(len(moved)), 0))])


CAUSES = (
    Cause("mount_tilt", Stage.ROBOT, "rad", 0.05, mount_tilt, freedom=2, motions=("displacement",)),
    Cause("robot_scale", Stage.ROBOT, "1", 0.02, robot_scale, freedom=3, motions=CARTESIAN),
    Cause("robot_shear", Stage.ROBOT, "1", 0.02, robot_shear, freedom=3, motions=CARTESIAN),
    Cause("position_lag", Stage.ROBOT, "m", 1e-3, position_lag),
    Cause("backlash", Stage.ROBOT, "m", 1e-3, backlash, freedom=3, motions=CARTESIAN),
    Cause("sensor_bumped", Stage.ROBOT, "m", 1e-3, sensor_bumped, freedom=4),
    Cause("position_jitter", Stage.ROBOT, "m", 3e-4, position_jitter, is_random=True),
)
