"""Flaws of the rig file: a number that it states well is not so. Where its prior is wide, a fit puts it right and nothing shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.causes.surroundings import vector
from tests.hidden.coil import blocks_of, circular_field
from tests.hidden.flaw import Cause, Known, Stage, Truth, afflicted_sensor, direction, sign
from tests.hidden.protocols import MOTIONS, Array
from tests.hidden.scene import Scene
from tests.hidden.ur_arm import flange_pose

LARGEST_M, LARGEST_RAD = 4e-3, np.deg2rad(3.0)
WINDING_NUMBERS = ("radius_m", "wire_radius_m", "axial_pitch_factor", "radial_pitch_factor")


def sensor_misplaced(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The sensor stands elsewhere in the room than stated, and turned about its own axes; size 1 is 4 mm, 3 degrees or both."""
    is_its, name = afflicted_sensor(scene, rng)
    shift_m, turn_rad, known = wrong_pose(size, rng)
    own = scene.world_from_sensor
    place_m = scene.sensor_position_m + is_its[:, None] * np.einsum("nij,j->ni", own, shift_m)
    turned = np.where(is_its[:, None, None], own @ Rotation.from_rotvec(turn_rad).as_matrix(), own)
    return replace(scene, sensor_position_m=place_m, world_from_sensor=turned), Truth(name, known)


def coil_misplaced(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The coil sits elsewhere on what carries it than stated, and turned; along and about the axes it should have."""
    shift_m, turn_rad, known = wrong_pose(size, rng)
    turn = Rotation.from_rotvec(turn_rad).as_matrix()
    mount = scene.flange_from_coil
    made = replace(scene, flange_from_coil=mount @ turn)
    if scene.arm is not None:
        made = replace(made, arm=replace(scene.arm, mount_m=scene.arm.mount_m + mount @ shift_m))
    else:
        place_m = scene.coil_position_m + scene.coil_rotation @ shift_m
        made = replace(made, coil_position_m=place_m, coil_rotation=scene.coil_rotation @ turn)
    return made, Truth("coil1", known)


def base_misplaced(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The robot's base stands elsewhere in the room than stated, and turned, along and about its own axes."""
    shift_m, turn_rad, known = wrong_pose(size, rng)
    assert scene.arm is not None
    own, turn = scene.arm.base_rotation, Rotation.from_rotvec(turn_rad).as_matrix()
    arm = replace(
        scene.arm, base_rotation=own @ turn, base_position_m=scene.arm.base_position_m + own @ shift_m
    )
    return replace(scene, arm=arm), Truth("arm1", known)


def joint_zeros(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The encoders' zeros are wrong: one joint by `size`, or all by as much together."""
    zero_rad = rng.normal(size=6)
    if rng.random() < 0.5:
        zero_rad[np.arange(6) != rng.integers(6)] = 0.0
    zero_rad *= size / np.linalg.norm(zero_rad)
    robot, commanded_rad = scene.schedule.motion, scene.schedule.joint_rad
    assert commanded_rad is not None
    turn, place_m = flange_pose(robot, commanded_rad + zero_rad)
    right_turn, right_m = flange_pose(robot, commanded_rad)
    assert scene.turn is not None
    made = replace(
        scene,
        displacement_m=scene.displacement_m + place_m - right_m,
        turn=turn @ right_turn.swapaxes(1, 2) @ scene.turn,
    )
    return made, Truth("arm1", tuple(Known(f"zero_q{k}_rad", v, "rad") for k, v in enumerate(zero_rad)))


def winding_misstated(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The radius, the wire or one pitch differs from what the maker states by the share `size`."""
    key, factor = WINDING_NUMBERS[int(rng.integers(4))], 1.0 + sign(rng) * size
    winding = replace(scene.winding, **{key: factor * getattr(scene.winding, key)})
    made = replace(scene, winding=winding, coil_field=circular_field(blocks_of(winding)))
    return made, Truth("coil1", (Known(f"{key}_factor", factor, "1"),))


def wrong_pose(size: float, rng: np.random.Generator) -> tuple[Array, Array, tuple[Known, ...]]:
    """A shift, a turn or both."""
    has_shift, has_turn = ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0))[int(rng.integers(3))]
    shift_m, turn_rad = (
        size * has_shift * LARGEST_M * direction(rng),
        size * has_turn * LARGEST_RAD * direction(rng),
    )
    return shift_m, turn_rad, (*vector("shift", shift_m, "m"), *vector("turn", turn_rad, "rad"))


CAUSES = (
    Cause("sensor_misplaced", Stage.ROBOT, "1", 1.0, sensor_misplaced, freedom=6),
    Cause("coil_misplaced", Stage.ROBOT, "1", 1.0, coil_misplaced, freedom=6),
    Cause("base_misplaced", Stage.ROBOT, "1", 1.0, base_misplaced, freedom=6, motions=MOTIONS[1:]),
    Cause("joint_zeros", Stage.ROBOT, "rad", np.deg2rad(1.0), joint_zeros, freedom=6, motions=MOTIONS[2:]),
    Cause("winding_misstated", Stage.WINDING, "1", 0.1, winding_misstated, freedom=4),
)
