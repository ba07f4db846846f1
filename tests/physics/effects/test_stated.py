"""What is stated and is not so: the reading with the cause is the reading at poses, and of windings, worked out by hand."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from estimator.geometry.kinematics import base_from_flange, base_from_joints
from estimator.model.room_field import RoomField
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import (
    POINTS_M,
    RIG,
    assert_same_field,
    effects_text,
    predicted_T,
    readings,
    winding,
)
from tests.physics.effects.test_robot import (
    TURNS,
    at_poses_T,
)

SHIFT_M, TURN_RAD = np.array([2e-3, -1e-3, 3e-3]), np.array([0.02, -0.03, 0.01])
TURN = Rotation.from_rotvec(TURN_RAD)
ELSEWHERE = dict(zip(("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"), (*SHIFT_M, *TURN_RAD), strict=True))
AT_POSES = readings(POINTS_M, (1.0, 0.0), turn_rad=TURNS.as_rotvec())
# An arm of six joints carries the probe, a standing coil looks at it.
ARM = RIG.replace("motion: pose", "motion: UR3e").replace(
    "{radius_mm: 40", "{world_from_coil: {x_mm: -300, y_mm: -250, z_mm: 300}, radius_mm: 40"
)
COIL_M = np.array([-0.3, -0.25, 0.3])
JOINTS_RAD = np.array([[0.1, -1.2, -1.4, 0.3, 1.2, 0.2], [0.3, -1.4, -1.2, -0.2, 0.9, -0.5]])


def test_misplaced_coil_that_stands_in_the_room_is_moved_and_turned_in_its_own_axes():
    reading_T = predicted_T(AT_POSES, {"coil_misplaced[coil]": ELSEWHERE})
    in_coil_m = TURN.inv().apply(POINTS_M - SHIFT_M)
    assert_same_field(reading_T, TURNS.inv().apply(TURN.apply(winding().field_T(in_coil_m))))


def test_misplaced_base_takes_everything_along_that_its_mover_carries():
    reading_T = predicted_T(AT_POSES, {"base_misplaced[mapper]": ELSEWHERE})
    assert_same_field(reading_T, at_poses_T(SHIFT_M + TURN.apply(POINTS_M), TURN * TURNS))


def of_arm_T(joints_rad: np.ndarray) -> np.ndarray:
    """What the probe on the flange of the arm reads of one ampere in the coil."""
    flange = base_from_flange("UR3e", torch.from_numpy(joints_rad))
    in_coil_m = flange.translation_m.numpy() - COIL_M
    return Rotation.from_matrix(flange.rotation.numpy()).inv().apply(winding().field_T(in_coil_m))


def test_joint_zeros_are_added_to_every_joint_angle():
    zeros_rad = np.array([2e-3, -3e-3, 4e-3, 5e-3, -6e-3, 7e-3])
    given = {"joint_zeros[mapper]": {f"q{i}_rad": zero_rad for i, zero_rad in enumerate(zeros_rad)}}
    session = readings(JOINTS_RAD[:, :3], (1.0, 0.0), turn_rad=JOINTS_RAD[:, 3:])
    assert_same_field(predicted_T(session, given, ARM), of_arm_T(JOINTS_RAD + zeros_rad))
    assert np.abs(of_arm_T(JOINTS_RAD + zeros_rad) / of_arm_T(JOINTS_RAD) - 1.0).max() > 1e-3


def test_joints_sag_by_their_compliance_times_the_torque_of_virtual_work():
    """The torque of a unit weight about a joint is how fast the weight sinks as the joint turns."""
    compliances = {"shoulder_by_elbow": (1, 2, 4e-3), "shoulder": (1, 6, 2e-3), "elbow": (2, 6, -3e-3)}
    sagging_rad, step_rad = JOINTS_RAD.copy(), 1e-6
    for joint, weight, compliance in compliances.values():
        high_m, low_m = (
            base_from_joints("UR3e", torch.from_numpy(JOINTS_RAD + sign * step_rad * np.eye(6)[joint]))[
                weight
            ]
            .translation_m[:, 2]
            .numpy()
            for sign in (1.0, -1.0)
        )
        sagging_rad[:, joint] -= compliance * (high_m - low_m) / (2.0 * step_rad)
    given = {f"{name}_rad_per_m": compliance for name, (_, _, compliance) in compliances.items()}
    session = readings(JOINTS_RAD[:, :3], (1.0, 0.0), turn_rad=JOINTS_RAD[:, 3:])
    assert_same_field(predicted_T(session, {"joint_sag[mapper]": given}, ARM), of_arm_T(sagging_rad), 1e-8)
    assert np.abs(of_arm_T(sagging_rad) / of_arm_T(JOINTS_RAD) - 1.0).max() > 1e-4


def test_field_of_a_coil_on_an_arm_with_other_zeros_is_predicted_at_its_angles_and_not_at_zero():
    on_arm = ARM.replace("{world_from_coil: {x_mm: -300, y_mm: -250, z_mm: 300},", "{carried_by: mapper,")
    rig = rig_from_text(on_arm + effects_text({"joint_zeros[mapper]": {"q1_rad": 0.01, "q4_rad": -0.02}}))
    plain = rig_from_text(on_arm)
    points_m = torch.tensor([[-0.25, -0.2, 0.2], [-0.2, -0.25, 0.3]], dtype=torch.float64)
    zeros_rad = torch.tensor([0.0, 0.01, 0.0, 0.0, -0.02, 0.0], dtype=torch.float64)
    joints_rad = torch.from_numpy(JOINTS_RAD)

    def field_T(rig_of, motion):
        values = {k: torch.tensor(v, dtype=torch.float64) for k, v in rig_of.nominal_values().items()}
        field = RoomField(rig_of, values, points_m, {"mapper": motion}, tolerance=1e-12)
        return field.field_T(values, torch.tensor([1.0, 0.0], dtype=torch.float64)).numpy()

    for motion in (joints_rad[0], joints_rad):
        assert_same_field(field_T(rig, motion), field_T(plain, motion + zeros_rad))


def test_misstated_winding_is_a_winding_with_other_numbers():
    """Of whole numbers of loops, so that they can be counted: 9 by 5 instead of 6 by 4."""
    given = {"radius": 0.02, "wire": -0.05, "axial_loops": 0.5, "radial_loops": 0.25}
    reading_T = predicted_T(readings(POINTS_M, (1.0, 0.0)), {"winding_misstated[coil]": given})
    real = winding(0.0408, 9, 5, 0.95e-3, 0.95e-3)
    assert_same_field(reading_T, real.field_T(POINTS_M))
