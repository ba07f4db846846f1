from __future__ import annotations

from dataclasses import astuple
from math import pi

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from torch import Tensor
from torch.func import jacfwd, jacrev, vmap

from estimator.errors import InvalidInput
from estimator.frames import rotation_from_vector, vector_from_rotation
from estimator.geometry.kinematics import base_from_flange
from estimator.geometry.motion import base_from_motion
from estimator.rig.arms import ARMS, DenavitHartenberg
from estimator.rig.bodies import MotionKind, Mover

# Arms of which public sources hold joint angles together with the controller's own answer. All these robots
# share one geometry, so they prove the formula and every convention; the UR3 and UR3e tables come after.
# UR5e: same support page as in kinematics.py. Controllers write pi / 2 in ten digits (urcontrol.conf), which
# shows in the tenth digit of an orientation.
UR5E = DenavitHartenberg(
    theta_rad=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    a_m=(0.0, -0.425, -0.3922, 0.0, 0.0, 0.0),
    d_m=(0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996),
    alpha_rad=(1.570796327, 0.0, 0.0, 1.570796327, -1.570796327, 0.0),
)
# UR10e in a laboratory, factory-corrected: GitHub pharmbio/robotlab, notes.md, <Kinematics> of a waypoint in
# a PolyScope program. (Shifts along parallel axes cancel, so the corrections may be huge.)
UR10E_CORRECTED = DenavitHartenberg(
    theta_rad=(
        *(-8.844411260213857e-8, -0.032582961261549755, -0.8772929446404238),
        *(0.9098787703504071, 2.101429764675086e-6, -1.9523604853220917e-7),
    ),
    a_m=(
        *(1.2280920183406098e-4, -0.6118328650166482, -0.35064142434212725),
        *(6.353071874199852e-5, -8.491717228743712e-5, 0.0),
    ),
    d_m=(
        *(0.18107019996630838, -11.986107840354439, 254.02185121292118),
        *(-241.86139249326118, 0.11978728860232488, 0.11569307278026907),
    ),
    alpha_rad=(
        *(1.570573614624119, 0.0016638537326948237, -0.0018631164519257151),
        *(1.5706607381785331, -1.5704473543987978, 0.0),
    ),
)
URSIM_START_RAD = (-1.6007, -1.7271, -2.203, -0.808, 1.5951, -0.031)
CONTROLLER_POSES = {
    # Universal Robots' simulator for the UR5e, no tool offset; script written by its PolyScope, quoted in the
    # Mamezou developer portal, robotics/ur/ursim-docker (2023-03-29).
    "simulated UR5e, first": (
        UR5E,
        URSIM_START_RAD,
        (-0.143968656714, -0.435620060803, 0.202030025428, -0.001221359682, 3.116276528482, 0.038891915637),
    ),
    "simulated UR5e, second": (
        UR5E,
        (
            *(-1.6006999999466975, -1.5433880589507778, -2.04162795671306),
            *(-1.1530839843348648, 1.5951000000013709, -0.030999999946700108),
        ),
        (-0.143968656711, -0.435620060727, 0.316972358784, -0.001221359682, 3.116276528482, 0.038891915637),
    ),
    # A real arm: pharmbio/robotlab, notes.md, Waypoint_1_q and Waypoint_1_p of the program named above.
    "real UR10e": (
        UR10E_CORRECTED,
        (
            *(1.9942498207092285, -1.6684614620604457, 1.9330504576312464),
            *(-0.2718423169902344, 1.3209004402160645, 0.0036344528198242188),
        ),
        (0.433025361705, -0.467959205379, 0.522310714714, 1.500318891221, 0.521427297251, 0.530987104689),
    ),
}


def tensor(values: object) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def random_joints_rad(*shape: int) -> Tensor:
    uniform = torch.rand(*shape, 6, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    return (2 * uniform - 1) * 2 * pi


@pytest.mark.parametrize("name", CONTROLLER_POSES)
def test_pose_agrees_with_the_robot_controller_to_all_printed_digits(name):
    robot, joints_rad, pose = CONTROLLER_POSES[name]
    flange = base_from_flange(robot, tensor(joints_rad))
    torch.testing.assert_close(flange.translation_m, tensor(pose[:3]), rtol=0, atol=5e-11)
    torch.testing.assert_close(vector_from_rotation(flange.rotation), tensor(pose[3:]), rtol=0, atol=5e-11)


def test_ur3e_pose_agrees_with_the_simulated_controller():
    """Pose of `tool0` in `base` at the start joints of the simulator.

    GitHub antisnoop12/My-project, Assets/Scripts/GridPathRosClient.cs (gridOrigin, orientation). The file
    names no joints; its orientation is that of the start joints, so its position tests the table.
    """
    flange = base_from_flange("UR3e", tensor(URSIM_START_RAD))
    position_m = tensor([-0.13686154, -0.26718082, 0.14697126])
    torch.testing.assert_close(flange.translation_m, position_m, rtol=0, atol=1e-8)
    x, y, z, w = -0.00039187, 0.99984348, 0.01247830, 0.01253627
    expected = rotation_from_vector(2 * np.arccos(w) / np.sqrt(1 - w**2) * tensor([x, y, z]))
    torch.testing.assert_close(flange.rotation, expected, rtol=0, atol=5e-8)


def test_factory_corrections_of_a_mover_are_added_to_the_nominal_table():
    nominal = ARMS["UR10e"]
    columns = zip(astuple(UR10E_CORRECTED), astuple(nominal), strict=True)
    measured = DenavitHartenberg(*(tuple(b - a for b, a in zip(*both, strict=True)) for both in columns))
    arm = Mover("arm1", MotionKind.UR10E, own_table=measured)
    joints_rad = random_joints_rad(3)
    flange = base_from_motion(arm, joints_rad)
    expected = base_from_flange(UR10E_CORRECTED, joints_rad)
    torch.testing.assert_close(flange.translation_m, expected.translation_m, rtol=0, atol=1e-12)
    far = base_from_motion(Mover("arm1", MotionKind.UR10E), joints_rad)
    assert float((far.translation_m - expected.translation_m).norm(dim=-1).min()) > 1e-4


def test_an_arm_of_any_maker_has_the_kinematics_of_its_table():
    arm = Mover("arm1", MotionKind.JOINTS, own_table=ARMS["UR5e"])
    joints_rad = random_joints_rad(3)
    assert arm.columns[0] == "arm1_q0_rad"
    torch.testing.assert_close(
        base_from_motion(arm, joints_rad).translation_m, base_from_flange("UR5e", joints_rad).translation_m
    )


def test_nominal_table_places_a_real_ur3e_within_two_millimetres_and_the_ur3_table_does_not():
    """Joints and flange by the controller of one: GitHub Olympus-Controls/UR-Docker, tests/test_armfk.py."""
    joints_rad = tensor([-1.021, -1.557, 2.302, -2.881, -1.852, 0.61])
    controller_m = tensor([-0.2359, 0.1825, 0.2213])
    error_m = {
        name: (base_from_flange(name, joints_rad).translation_m - controller_m).norm() for name in ARMS
    }
    assert error_m["UR3e"] < 2e-3
    assert error_m["UR3"] > 1e-2


# For a second formula: lengths of the arm, all positive: height of the shoulder, upper arm, forearm, and the
# three offsets from joint to joint in the wrist.
LENGTHS_M = {
    "UR3": (0.1519, 0.24365, 0.21325, 0.11235, 0.08535, 0.0819),
    "UR5": (0.089159, 0.425, 0.39225, 0.10915, 0.09465, 0.0823),
    "UR10": (0.1273, 0.612, 0.5723, 0.163941, 0.1157, 0.0922),
    "UR3e": (0.15185, 0.24355, 0.2132, 0.13105, 0.08535, 0.0921),
    "UR5e": (0.1625, 0.425, 0.3922, 0.1333, 0.0997, 0.0996),
    "UR10e": (0.1807, 0.6127, 0.57155, 0.17415, 0.11985, 0.11655),
    "UR16e": (0.1807, 0.4784, 0.36, 0.17415, 0.11985, 0.11655),
    "UR20": (0.2363, 0.862, 0.7287, 0.201, 0.1593, 0.1543),
}


def screw_axes(robot: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directions and points of the six joint axes, and the flange, in the zero pose of the arm.

    At zero the arm lies stretched out along -x at shoulder height. Shoulder, elbow and wrist 1 turn about -y:
    a negative shoulder angle lifts the arm. Wrist 2, one offset to the side, turns about a vertical axis
    pointing down; wrist 3 and the flange lie below it and face -y.
    """
    height, upper_arm, forearm, offset_1, offset_2, offset_3 = LENGTHS_M[robot]
    wrist_x = -(upper_arm + forearm)
    directions = np.array([[0, 0, 1], [0, -1, 0], [0, -1, 0], [0, -1, 0], [0, 0, -1], [0, -1, 0]])
    points = np.array(
        [
            [0, 0, 0],
            [0, 0, height],
            [-upper_arm, 0, height],
            [wrist_x, 0, height],
            [wrist_x, -offset_1, 0],
            [wrist_x, 0, height - offset_2],
        ]
    )
    flange = np.array(
        [[1, 0, 0, wrist_x], [0, 0, -1, -offset_1 - offset_3], [0, 1, 0, height - offset_2], [0, 0, 0, 1]]
    )
    return directions, points, flange


def product_of_exponentials(robot: str, joints_rad: np.ndarray) -> np.ndarray:
    """exp(S1 q1) ... exp(S6 q6) M, R. W. Brockett (1984)."""
    directions, points, pose = screw_axes(robot)
    for direction, point, joint_rad in reversed(list(zip(directions, points, joints_rad, strict=True))):
        x, y, z = direction
        twist = np.zeros((4, 4))
        twist[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        twist[:3, 3] = -np.cross(direction, point)
        pose = expm(twist * joint_rad) @ pose
    return pose


@pytest.mark.parametrize("robot", ARMS)
def test_poses_agree_with_the_product_of_exponentials_of_the_screw_axes(robot):
    joints_rad = random_joints_rad(5, 10)
    flange = base_from_flange(robot, joints_rad)
    expected = np.array([product_of_exponentials(robot, q) for q in joints_rad.reshape(-1, 6).numpy()])
    expected = tensor(expected).reshape(5, 10, 4, 4)
    torch.testing.assert_close(flange.rotation, expected[..., :3, :3], rtol=0, atol=3e-13)
    torch.testing.assert_close(flange.translation_m, expected[..., :3, 3], rtol=0, atol=3e-13)


@pytest.mark.parametrize("robot", ARMS)
def test_home_pose_stands_straight_up_with_the_flange_to_the_side(robot):
    height, upper_arm, forearm, offset_1, offset_2, offset_3 = LENGTHS_M[robot]
    flange = base_from_flange(robot, tensor([0.0, -pi / 2, 0.0, -pi / 2, 0.0, 0.0]))
    expected_m = tensor([0.0, -offset_1 - offset_3, height + upper_arm + forearm + offset_2])
    torch.testing.assert_close(flange.translation_m, expected_m, rtol=0, atol=1e-15)


@pytest.mark.parametrize("derivative", [jacfwd, jacrev])
@pytest.mark.parametrize("robot", ARMS)
def test_derivative_in_the_stretched_out_pose_is_that_of_turning_about_each_axis(robot, derivative):
    directions, points, flange = screw_axes(robot)
    expected_m = np.cross(directions, flange[:3, 3] - points).T
    zero = torch.zeros(6, dtype=torch.float64)
    jacobian_m = derivative(lambda q: base_from_flange(robot, q).translation_m)(zero)
    torch.testing.assert_close(jacobian_m, tensor(expected_m), rtol=0, atol=1e-15)


def test_derivative_agrees_with_central_differences_at_random_joints_under_vmap():
    joints_rad, step_rad = random_joints_rad(4), 1e-6

    def position_m(q: Tensor) -> Tensor:
        return base_from_flange("UR3e", q).translation_m

    steps = step_rad * torch.eye(6, dtype=torch.float64)
    ahead_m, behind_m = (position_m(joints_rad[:, None] + sign * steps) for sign in (1, -1))
    slope_m = (ahead_m - behind_m).mT / (2 * step_rad)
    torch.testing.assert_close(vmap(jacfwd(position_m))(joints_rad), slope_m, rtol=0, atol=1e-9)


def test_batch_equals_loop_and_single_precision_is_kept():
    joints_rad = random_joints_rad(2, 3)
    batched = base_from_flange("UR3", joints_rad)
    torch.testing.assert_close(
        batched.translation_m[1, 2], base_from_flange("UR3", joints_rad[1, 2]).translation_m
    )
    single = base_from_flange("UR3", joints_rad.float())
    assert single.rotation.dtype == single.translation_m.dtype == torch.float32
    torch.testing.assert_close(single.translation_m.double(), batched.translation_m, rtol=0, atol=2e-6)


def test_unknown_robot_is_refused_with_the_known_names():
    with pytest.raises(
        InvalidInput,
        match=r"robot must be one of UR3, UR5, UR10, UR3e, UR5e, UR10e, UR16e, UR20; received 'UR4'",
    ):
        base_from_flange("UR4", torch.zeros(6, dtype=torch.float64))
