"""What a rig file of the open world states: how the arm tells of itself, and how well winding and poses are known.

Half of the arms write down displacements, the others poses of the flange or joint angles, with turned poses among them. Half of the files
state pose and winding well (0.2 mm, 0.1 degrees, 1 %), half as a tape measure does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.protocols import CARTESIAN, MOTIONS, Array, Schedule
from tests.hidden.ur_arm import flange_pose, joints_reaching

NOMINAL = {"radius_m": 0.048, "wire_radius_m": 0.00046, "axial_loops": 45.0, "radial_loops": 22.0}
LOWER = {"wire_radius_m": 0.0002, "axial_loops": 1.0, "radial_loops": 1.0}
MOUNT_M = np.array([0.0, 0.0, 0.07])
POSE = ("x_m", "y_m", "z_m", "tilt_x_rad", "tilt_y_rad", "spin_rad")
BASE = tuple(f"base_{key}" for key in POSE)
MOUNT = tuple(f"mount_{key}" for key in POSE[:5])  # a round coil's spin shows nowhere
READY_RAD = np.deg2rad([0.0, -90.0, -90.0, 0.0, 90.0, 0.0])
LARGEST_TURN_RAD = np.deg2rad(12.0)
FREE_GAP_M, OUTREACH_M = (
    0.017,
    0.09,
)  # no reading is nearer to the face, where a turn would bring a rim of this distance
DEGREE = np.pi / 180.0

# Length and angle, of the pose of a coil at the reference, a base and a mount.
WIDE_SD = {"": (3e-3, 2.0 * DEGREE), "base_": (3e-3, 0.5 * DEGREE), "mount_": (1e-3, 1.0 * DEGREE)}
TIGHT_SD = (0.2e-3, 0.1 * DEGREE)
WIDE_WINDING_SD = {"radius_m": 3e-3, "wire_radius_m": 0.03e-3, "axial_loops": 3.0, "radial_loops": 3.0}
TIGHT_SHARE = 0.01


@dataclass(frozen=True)
class StatedRig:
    """Nominal values and priors of a rig file.

    Attributes:
        motion: One of `MOTIONS`.
        is_tight: Pose and winding are known well.
        prior_sd: Of every free number; the names are those of `visible_size`, with `base_` and `mount_` before those of a pose.
        distance_m: Of the coil's front face from the room's origin at the reference.
        base_rotation, base_position_m: Nominal world_from_base; None where displacements are written down.
    """

    motion: str
    is_tight: bool
    prior_sd: Mapping[str, float]
    distance_m: float
    base_rotation: Array | None = None
    base_position_m: Array | None = None

    def mean(self, name: str) -> float:
        """Nominal value of a free number, the middle of its prior."""
        if name in NOMINAL:
            return NOMINAL[name]
        axis = "xyz".find(name[-3])
        if "tilt" in name or "spin" in name:
            return 0.0
        if name.startswith("mount_"):
            return float(MOUNT_M[axis])
        if self.base_position_m is not None:
            return float(self.base_position_m[axis])
        return -self.distance_m if name == "z_m" else 0.0

    def key(self, name: str) -> str:
        """A free number as coilcal calls it."""
        if name in NOMINAL:
            return f"coil1.{name}"
        if name.startswith("base_"):
            return f"arm1.world_from_base.{name.removeprefix('base_')}"
        if name.startswith("mount_"):
            return f"coil1.flange_from_coil.{name.removeprefix('mount_')}"
        return f"coil1.world_from_coil0.{name}"

    def text(self, title: str) -> str:
        """Movers and coil1 of the rig file."""
        lines = [
            "schema_version: 1",
            f"name: {title}",
            "",
            "movers:",
            "  arm1:",
            f"    motion: {self.motion}",
        ]
        if self.base_rotation is None:
            lines.append("    displacement_frame: end_effector")
        else:
            turn = Rotation.from_matrix(self.base_rotation).as_rotvec()
            lines += ["    world_from_base:", *self._block("base_")]
            lines += [f"      r{axis}_rad: {v:.15g}" for axis, v in zip("xyz", turn, strict=True)]
        lines += ["", "coils:", "  coil1:", "    carried_by: arm1"]
        lines += [f"    {self._line(name)}" for name in NOMINAL]
        pose, prefix = (
            ("world_from_coil0", "") if self.base_rotation is None else ("flange_from_coil", "mount_")
        )
        return "\n".join([*lines, f"    {pose}:", *self._block(prefix)]) + "\n"

    def _block(self, prefix: str) -> Iterator[str]:
        """The free numbers of a pose."""
        for key in POSE:
            if prefix + key in self.prior_sd:
                yield f"      {self._line(prefix + key)}"

    def _line(self, name: str) -> str:
        """One number with its prior; lengths in millimetres, angles in radians."""
        key = name.removeprefix("base_").removeprefix("mount_")
        factor = 1e3 if name.endswith("_m") else 1.0
        bound = f", lower: {factor * LOWER[name]:g}" if name in LOWER else ""
        normal = f"mean: {factor * self.mean(name):.15g}, sd: {factor * self.prior_sd[name]:.15g}{bound}"
        return (
            f"{key.removesuffix('_m') + '_mm' if factor > 1.0 else key}: {{prior: {{normal: {{{normal}}}}}}}"
        )


def draw_rig(schedule: Schedule, rng: np.random.Generator) -> tuple[StatedRig, Schedule]:
    """A rig file for a schedule of displacements, and the schedule as that arm writes it down."""
    is_relative, is_tight = rng.random() < 0.5, bool(rng.random() < 0.5)
    motion = MOTIONS[0] if is_relative else str(rng.choice(MOTIONS[1:], p=(0.5, 0.25, 0.25)))
    prior_sd = {name: TIGHT_SHARE * NOMINAL[name] if is_tight else sd for name, sd in WIDE_WINDING_SD.items()}
    for name in POSE[:5] if is_relative else (*BASE, *MOUNT):
        prefix = name.partition("_")[0] + "_" if name in (*BASE, *MOUNT) else ""
        prior_sd[name] = (TIGHT_SD if is_tight else WIDE_SD[prefix])[name.endswith("_rad")]
    rig = StatedRig(motion, is_tight, prior_sd, schedule.distance_m)
    return (rig, schedule) if is_relative else with_poses(rig, schedule, rng)


def with_poses(rig: StatedRig, schedule: Schedule, rng: np.random.Generator) -> tuple[StatedRig, Schedule]:
    """The nominal base from which the flange comes to the places of a schedule, with a turn of its own at half of them."""
    ready_rad = READY_RAD + 0.1 * rng.normal(size=6)
    if rig.motion in CARTESIAN:  # a tool that points down, half a metre and less from the base
        spin = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        first = (Rotation.from_rotvec([np.pi, 0.0, 0.0]) * spin).as_matrix()
        first_m = np.array([rng.uniform(0.25, 0.45), rng.uniform(-0.2, 0.2), rng.uniform(0.1, 0.4)])
    else:
        turns, places_m = flange_pose(rig.motion, ready_rad[None])
        first, first_m = turns[0], places_m[0]
    # The coil's frame is the world's but for its distance, so world_from_flange is a shift at the reference.
    world_from_flange_m = np.array([0.0, 0.0, -schedule.distance_m]) - MOUNT_M
    base_rotation = first.T
    base_position_m = world_from_flange_m - base_rotation @ first_m
    turn = _turns(schedule, rng)
    coil_m = schedule.displacement_m - np.array([0.0, 0.0, schedule.distance_m])
    place_m = (coil_m - turn @ MOUNT_M - base_position_m) @ base_rotation
    in_base = base_rotation.T @ turn
    joint_rad = None
    if rig.motion not in CARTESIAN:
        try:
            joint_rad = joints_reaching(rig.motion, in_base, place_m, ready_rad)
        except ValueError:  # one arm in thirty is set up so that it does not come everywhere
            return with_poses(rig, schedule, rng)
        in_base, place_m = flange_pose(rig.motion, joint_rad)
    return (
        replace(rig, base_rotation=base_rotation, base_position_m=base_position_m),
        replace(schedule, motion=rig.motion, displacement_m=place_m, turn=in_base, joint_rad=joint_rad),
    )


def _turns(schedule: Schedule, rng: np.random.Generator) -> Array:
    """Rotations of the coil from its pose at the reference; the same wherever a place is visited again, none that brings a rim too near."""
    places_m, place = np.unique(schedule.displacement_m, axis=0, return_inverse=True)
    gap_m = schedule.distance_m - places_m[:, 2]
    most_rad = np.clip((gap_m - FREE_GAP_M) / OUTREACH_M, 0.0, LARGEST_TURN_RAD)
    axis = rng.normal(size=places_m.shape)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    angle_rad = most_rad * rng.random(len(places_m)) * (rng.random(len(places_m)) < 0.5)
    return Rotation.from_rotvec((angle_rad[:, None] * axis)[place.ravel()]).as_matrix()
