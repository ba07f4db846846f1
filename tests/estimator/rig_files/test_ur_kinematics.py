"""Factory corrections from files of `ur_calibration`, written here by the algorithm that its documentation describes."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest
import torch
import yaml
from scipy.spatial.transform import Rotation

from estimator.errors import InvalidInput
from estimator.geometry.kinematics import base_from_flange
from estimator.geometry.motion import base_from_motion
from estimator.rig.arms import ARMS, DenavitHartenberg
from estimator.rig_files.arm_files import LINKS, corrections_from_ros
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.write import rig_text

DELTAS = DenavitHartenberg(  # as a controller reports them: large offsets that cancel, along axes that are nearly parallel
    theta_rad=(2e-7, -0.0171, -0.0371, 0.0542, 1.5e-7, 1.6e-5),
    a_m=(4.6e-5, -1.3e-4, 1.9e-3, 9.9e-5, 4.2e-6, 0.0),
    d_m=(6.6e-4, 1.444, 0.854, -2.299, -1.6e-5, 1.9e-5),
    alpha_rad=(2.1e-4, -7.3e-3, -1.35e-2, 1.3e-3, -1.3e-3, 0.0),
)
RIG = """
schema_version: 1
name: an arm with its own kinematics
movers: {arm: {motion: UR10e, factory_corrections: {file: my_robot_calibration.yaml}}}
coils: {coil1: {carried_by: arm, radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 3}}
sensors: {hall: {noise_uT: 5}}
"""


def pose(rotation: Rotation, translation_m: list[float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), translation_m
    return matrix


def extracted(table: DenavitHartenberg) -> str:
    """The file of an arm: each axis split in two segments, the offsets of joints 2 and 3 moved on, and segments joined to links."""
    chain = []
    for theta, a, d, alpha in zip(*astuple(table), strict=True):
        chain += [
            pose(Rotation.from_euler("z", theta), [0, 0, d]),
            pose(Rotation.from_euler("x", alpha), [a, 0, 0]),
        ]
    for link in (1, 2):
        passive = chain[2 * link] @ chain[2 * link + 1]
        origin = passive[:3, 3]
        direction = (passive @ chain[2 * link + 2])[:3, 3] - origin
        direction /= np.linalg.norm(direction)
        way = -origin[2] / direction[2]
        crossing = origin + way * direction
        theta = np.arctan(crossing[1] / crossing[0])
        chain[2 * link] = pose(Rotation.from_euler("z", theta), [0, 0, 0])
        turned = Rotation.from_euler("z", table.theta_rad[link] - theta) * Rotation.from_euler(
            "x", table.alpha_rad[link]
        )
        chain[2 * link + 1] = pose(turned, [-np.linalg.norm(crossing), 0, 0])
        chain[2 * link + 2][2, 3] -= way * np.sign(direction[2])
    links = [chain[0], *(chain[i] @ chain[i + 1] for i in range(1, 11, 2))]
    kinematics = {
        name: dict(zip("xyz", link[:3, 3].tolist(), strict=True))
        | dict(
            zip(
                ("roll", "pitch", "yaw"),
                Rotation.from_matrix(link[:3, :3]).as_euler("XYZ").tolist(),
                strict=True,
            )
        )
        for name, link in zip(LINKS, links, strict=True)
    }
    return yaml.safe_dump({"kinematics": {**kinematics, "hash": "calib_1234"}})


@pytest.mark.parametrize("robot", ["UR10e", "UR3"])
def test_the_flange_is_where_the_controller_has_it(robot, tmp_path):
    table = ARMS[robot].corrected(DELTAS)
    path = tmp_path / "calibration.yaml"
    path.write_text(extracted(table), encoding="utf-8")
    found = ARMS[robot].corrected(corrections_from_ros(path, robot))
    joints_rad = torch.from_numpy(np.random.default_rng(2).uniform(-3.1, 3.1, (20, 6)))
    there, expected = (base_from_flange(each, joints_rad) for each in (found, table))
    torch.testing.assert_close(there.translation_m, expected.translation_m, rtol=0.0, atol=1e-9)
    torch.testing.assert_close(there.rotation, expected.rotation, rtol=0.0, atol=1e-9)
    nominal = base_from_flange(robot, joints_rad)
    assert float((nominal.translation_m - expected.translation_m).norm(dim=-1).max()) > 1e-3


def test_a_rig_keeps_the_numbers_and_needs_the_file_no_more(tmp_path):
    calibration = tmp_path / "my_robot_calibration.yaml"
    calibration.write_text(extracted(ARMS["UR10e"].corrected(DELTAS)), encoding="utf-8")
    path = tmp_path / "rig.yaml"
    path.write_text(RIG, encoding="utf-8")
    rig = load_rig(path)
    calibration.unlink()
    again = rig_from_text(rig_text(rig))
    assert again.hash == rig.hash
    joints_rad = torch.tensor([[0.1, -1.2, 1.3, 0.4, 1.5, 0.6]], dtype=torch.float64)
    expected = base_from_flange(ARMS["UR10e"].corrected(DELTAS), joints_rad)
    torch.testing.assert_close(
        base_from_motion(again.movers[0], joints_rad).translation_m,
        expected.translation_m,
        rtol=0.0,
        atol=1e-9,
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("wrist_2:", "wrist_5:", "kinematics.wrist_2.x is missing"),
        ("kinematics:", "kinematics: [", "must be YAML; "),
    ],
)
def test_a_file_of_another_form_is_refused(old, new, message, tmp_path):
    (tmp_path / "rig.yaml").write_text(RIG, encoding="utf-8")
    text = extracted(ARMS["UR10e"].corrected(DELTAS)).replace(old, new)
    (tmp_path / "my_robot_calibration.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=f"movers.arm.factory_corrections: .*{message}"):
        load_rig(tmp_path / "rig.yaml")


def test_a_file_of_another_model_is_refused(tmp_path):
    path = tmp_path / "calibration.yaml"
    path.write_text(extracted(ARMS["UR5e"].corrected(DELTAS)), encoding="utf-8")
    with pytest.raises(
        InvalidInput, match=r"must be of a UR10e, whose arm is 1\.184 m long; it is of one with 0\.8"
    ):
        corrections_from_ros(path, "UR10e")


def test_a_rig_that_is_not_on_disk_cannot_name_a_file():
    with pytest.raises(InvalidInput, match="must stand in a rig file on disk, beside its file of links"):
        rig_from_text(RIG)
