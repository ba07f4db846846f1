"""Frames for ROS, followed through the tree by a reader of its own, against the poses of the model."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.errors import InvalidInput
from estimator.export.frames_urdf import rpy_rad
from estimator.frames import Transform, rotation_from_vector
from estimator.model.room_field import at_one_moment
from estimator.rig_files.read import rig_from_text

ONE = torch.zeros(1, dtype=torch.int64)


def homogeneous(rotation: np.ndarray, translation_m: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation_m
    return pose


def followed(path: Path, body: str, motion: dict[str, np.ndarray]) -> np.ndarray:
    """Pose of a link in the world, as the URDF specification says: origin (fixed-axis roll, pitch, yaw), then the joint."""
    joints = {
        joint.find("child").attrib["link"]: joint for joint in ElementTree.parse(path).getroot().iter("joint")
    }  # type: ignore[union-attr]
    pose, link = np.eye(4), body
    while link != "world":
        joint: Any = joints[link]
        origin = {
            key: np.array(text.split(), dtype=float) for key, text in joint.find("origin").attrib.items()
        }
        here = homogeneous(Rotation.from_euler("xyz", origin["rpy"]).as_matrix(), origin["xyz"])
        if joint.attrib["type"] == "revolute":
            angle_rad = motion["arm"][int(joint.attrib["name"].removeprefix("arm_q"))]
            here = here @ homogeneous(Rotation.from_rotvec([0.0, 0.0, angle_rad]).as_matrix(), np.zeros(3))
        elif joint.attrib["type"] == "floating":
            numbers = motion["stage"]
            here = here @ homogeneous(Rotation.from_rotvec(numbers[3:]).as_matrix(), numbers[:3])
        pose, link = here @ pose, joint.find("parent").attrib["link"]
    return pose


def test_every_body_stands_where_the_model_has_it(magnet, motion, tmp_path):
    path = magnet.export("urdf", tmp_path / "magnet.urdf")
    sources = at_one_moment(magnet.rig, 1, motion)
    numbers = {name: row.numpy() for name, row in motion.items()}
    for kind, bodies in (("coil", magnet.rig.coils), ("sensor", magnet.rig.sensors)):
        for body in bodies:
            expected = sources.world_from_body(body, kind, ONE, magnet.best_values())
            pose = homogeneous(
                expected.rotation.reshape(3, 3).numpy(), expected.translation_m.reshape(3).numpy()
            )
            np.testing.assert_allclose(followed(path, body.name, numbers), pose, atol=1e-12)


def test_launch_file_publishes_the_fixed_transforms(magnet, tmp_path, monkeypatch):
    """ROS 2 is not at hand: stand-ins of the two classes that it uses take what the file says."""
    launch, launch_ros, actions = (
        ModuleType("launch"),
        ModuleType("launch_ros"),
        ModuleType("launch_ros.actions"),
    )
    launch.LaunchDescription = list  # type: ignore[attr-defined]
    actions.Node = lambda **keys: keys  # type: ignore[attr-defined]
    for module in (launch, launch_ros, actions):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    path = magnet.export("tf", tmp_path / "magnet.launch.py")
    nodes = runpy.run_path(str(path))["generate_launch_description"]()
    said = [dict(zip(node["arguments"][::2], node["arguments"][1::2], strict=True)) for node in nodes]
    assert {node["executable"] for node in nodes} == {"static_transform_publisher"}
    frames = {(row["--frame-id"], row["--child-frame-id"]): row for row in said}
    assert ("arm_flange", "carried") in frames
    standing = frames["world", "standing"]
    quaternion = [float(standing[f"--q{axis}"]) for axis in "xyzw"]
    np.testing.assert_allclose([float(standing[f"--{axis}"]) for axis in "xyz"], [0.09, 0.0, 0.0], atol=1e-15)
    tree = followed(magnet.export("urdf", tmp_path / "magnet.urdf"), "standing", {})
    np.testing.assert_allclose(Rotation.from_quat(quaternion).as_matrix(), tree[:3, :3], atol=1e-12)


@pytest.mark.parametrize(
    "vector_rad", [[0.0, np.pi / 2, 0.0], [0.3, -2.0, 1.0], [0.0, -np.pi / 2, 0.0], [0.0, 0.0, 0.0]]
)
def test_roll_pitch_yaw_give_the_rotation_also_in_gimbal_lock(vector_rad):
    rotation = rotation_from_vector(torch.tensor(vector_rad, dtype=torch.float64))
    angles_rad = rpy_rad(Transform(rotation, torch.zeros(3, dtype=torch.float64)))
    np.testing.assert_allclose(Rotation.from_euler("xyz", angles_rad).as_matrix(), rotation, atol=1e-12)


def test_movers_that_do_not_stand_where_they_say_are_refused(calibrated, rig_text, tmp_path):
    rig = rig_from_text(f"{rig_text}effects:\n  robot_scale[arm1]: {{x: 0.01, y: 0, z: 0}}")
    with pytest.raises(InvalidInput, match=r"robot_scale\[arm1\] of rig 'small' changes them"):
        calibrated(rig).export("urdf", tmp_path / "small.urdf")
