"""Arms from URDF files: the pose of the flange is that of the library that reads them, and the rig needs the file no more."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator.effects.causes.robot import joint_zeros
from estimator.effects.circumstances import Circumstances
from estimator.errors import InvalidInput
from estimator.export.plain_model import plain_model
from estimator.geometry.kinematics import base_from_flange
from estimator.geometry.motion import base_from_motion, motion_reached
from estimator.readings.observations import Observations
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.write import rig_text
from tests.estimator.rig_files.test_write import check_same

yourdfpy = pytest.importorskip("yourdfpy")

RIG = """\
schema_version: 1
name: an arm of its own
movers:
  arm:
    motion: joints
    urdf: {file: arm.urdf, base: stand, flange: tool}
    world_from_base: {x_mm: 100, rz_deg: 40}
coils: {coil1: {carried_by: arm, radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 3, flange_from_coil: {z_mm: 20}}}
sensors: {hall: {noise_uT: 5}}
"""
Row = tuple[
    tuple[float, ...], tuple[float, ...], tuple[float, ...]
]  # position, roll-pitch-yaw and axis of a joint


def urdf(rows: list[Row], kinds: list[str] | None = None) -> str:
    kinds = kinds or ["revolute"] * len(rows)
    text = '<robot name="arm"><link name="stand"/><link name="l0"/>'
    text += '<joint name="foot" type="fixed"><parent link="stand"/><child link="l0"/>'
    text += '<origin xyz="0.1 -0.2 0.3" rpy="0.3 -0.2 1.1"/></joint>'
    for i, ((xyz, rpy, axis), kind) in enumerate(zip(rows, kinds, strict=True)):
        words = [" ".join(repr(float(v)) for v in part) for part in (xyz, rpy, axis)]
        text += f'<link name="l{i + 1}"/><joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
        text += f'<origin xyz="{words[0]}" rpy="{words[1]}"/><axis xyz="{words[2]}"/>'
        text += '<limit lower="-6" upper="6" effort="1" velocity="1"/></joint>'
    text += f'<link name="tool"/><joint name="hand" type="fixed"><parent link="l{len(rows)}"/><child link="tool"/>'
    return text + '<origin xyz="0.02 0.01 0.08" rpy="-1.2 0.4 0.1"/></joint></robot>'


def askew(seed: int) -> list[Row]:
    rng = np.random.default_rng(seed)
    return [
        (tuple(rng.uniform(-0.4, 0.4, 3)), tuple(rng.uniform(-3.0, 3.0, 3)), tuple(rng.normal(size=3)))
        for _ in range(6)
    ]


Z, Y = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
NONE = (0.0, 0.0, 0.0)
ARMS = {
    "askew": askew(0),
    "other askew": askew(1),
    # Parallel, intersecting and coincident axes, one of them the other way round.
    "upright": [
        ((0.0, 0.0, 0.1), NONE, Z),
        ((0.0, 0.0, 0.2), NONE, Y),
        ((0.4, 0.03, 0.0), NONE, (0.0, 1.0, 0.0)),
        ((0.35, 0.0, 0.0), NONE, Y),
        ((0.0, -0.1, 0.0), NONE, Z),
        ((0.0, 0.0, 0.07), NONE, (0.0, 0.0, -1.0)),
    ],
    # Right angles with few digits, as makers write them.
    "rounded": [((0.1, 0.05 * i, 0.2), (1.5708 * (i % 2), 0.0, 1.5708), Z) for i in range(6)],
}


@pytest.mark.parametrize("rows", ARMS.values(), ids=ARMS)
def test_flange_stands_where_the_library_has_it(rows, tmp_path):
    (tmp_path / "arm.urdf").write_text(urdf(rows))
    (tmp_path / "rig.yaml").write_text(RIG)
    rig = load_rig(tmp_path / "rig.yaml")
    joints_rad = np.random.default_rng(2).uniform(-3.0, 3.0, (30, 6))
    found = base_from_motion(rig.movers[0], torch.from_numpy(joints_rad))
    robot = yourdfpy.URDF.load(str(tmp_path / "arm.urdf"))
    for i, row in enumerate(joints_rad):
        robot.update_cfg(row)
        expected = robot.get_transform("tool", "stand")
        np.testing.assert_allclose(found.rotation[i], expected[:3, :3], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(found.translation_m[i], expected[:3, 3], rtol=0.0, atol=1e-9)


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    (tmp_path / "arm.urdf").write_text(urdf(ARMS["askew"]))
    (tmp_path / "rig.yaml").write_text(RIG)
    return load_rig(tmp_path / "rig.yaml")


def test_the_rig_holds_the_chain_and_needs_no_file(rig):
    assert "urdf" not in rig_text(rig)
    check_same(rig)


def test_another_arm_is_another_rig(rig, tmp_path):
    (tmp_path / "arm.urdf").write_text(
        urdf(ARMS["askew"]).replace('xyz="0.02 0.01 0.08"', 'xyz="0.02 0.01 0.09"')
    )
    assert load_rig(tmp_path / "rig.yaml").hash != rig.hash


def test_joints_are_found_from_the_pose(rig):
    near_rad = torch.tensor([[0.3, -0.5, 0.8, 0.2, 0.9, -0.4]], dtype=torch.float64)
    pose = base_from_motion(rig.movers[0], near_rad + 0.02)
    found = motion_reached(rig.movers[0], pose, pose, near_rad)
    torch.testing.assert_close(found, near_rad + 0.02, rtol=0.0, atol=1e-7)  # Newton's method ends there


def test_zeros_of_its_joints_move_it_as_their_readings_would(rig):
    motion = torch.from_numpy(np.random.default_rng(3).uniform(-1.0, 1.0, (4, 6)))
    observations = Observations.of(torch.ones(4, 1).double(), {"arm": motion}, torch.zeros(4, 3).double())
    columns = joint_zeros.columns(Circumstances(rig, observations), "arm")
    zeros_rad = torch.tensor([2e-3, -1e-3, 3e-3, 1e-3, -2e-3, 2e-3], dtype=torch.float64)
    theta = {f"q{i}_rad": zeros_rad[i] for i in range(6)}
    moved = joint_zeros.apply(base_from_motion(rig.movers[0], motion), columns, theta)
    expected = base_from_motion(rig.movers[0], motion + zeros_rad)
    torch.testing.assert_close(moved.translation_m, expected.translation_m, rtol=0.0, atol=1e-12)


def test_exports_hold_both_ends(rig):
    model = plain_model(rig, nominal_tensors(rig), "json")
    joints_rad = torch.tensor([0.3, -0.5, 0.8, 0.2, 0.9, -0.4], dtype=torch.float64)
    coil = model.coils[0]
    assert model.movers[0].joints is not None
    chain = (
        coil.world_from_base @ base_from_flange(model.movers[0].joints, joints_rad) @ coil.flange_from_coil
    )
    turn = np.deg2rad(40.0)
    arm = base_from_motion(rig.movers[0], joints_rad[None])
    at_m = arm.apply(torch.tensor([0.0, 0.0, 0.02], dtype=torch.float64))[0].numpy()
    x, y, z = chain.translation_m.tolist()
    assert (x, y) == pytest.approx(
        (
            0.1 + at_m[0] * np.cos(turn) - at_m[1] * np.sin(turn),
            at_m[0] * np.sin(turn) + at_m[1] * np.cos(turn),
        ),
        abs=1e-12,
    )
    assert z == pytest.approx(at_m[2], abs=1e-12)


@pytest.mark.parametrize(
    ("change", "text", "message"),
    [
        (RIG, urdf(askew(0)[:5]), "must have 6 turning joints from stand to tool; it has 5"),
        (RIG, urdf([*askew(0), *askew(1)[:1]]), "it has 7"),
        (RIG, urdf(askew(0), ["revolute"] * 5 + ["prismatic"]), "must turn freely or be fixed; j5 does not"),
        (RIG.replace("flange: tool", "flange: gripper"), urdf(askew(0)), "from link 'stand' to 'gripper'"),
        (RIG, "<robot", "must be a URDF that can be read"),
        (RIG.replace("arm.urdf", "leg.urdf"), urdf(askew(0)), "must be a URDF that can be read"),
        (RIG.replace(", flange: tool", ""), urdf(askew(0)), "movers.arm.urdf.flange is missing"),
    ],
)
def test_what_is_no_such_arm_is_refused_with_its_line(change, text, message, tmp_path):
    (tmp_path / "arm.urdf").write_text(text)
    (tmp_path / "rig.yaml").write_text(change)
    with pytest.raises(InvalidInput) as caught:
        load_rig(tmp_path / "rig.yaml")
    assert message in str(caught.value)
    assert "rig.yaml, line 6" in str(caught.value)


def test_a_text_from_elsewhere_opens_no_file():
    with pytest.raises(InvalidInput, match="urdf must stand in a rig file on disk"):
        rig_from_text(RIG)


def test_without_the_library_a_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "yourdfpy", None)
    (tmp_path / "arm.urdf").write_text(urdf(askew(0)))
    (tmp_path / "rig.yaml").write_text(RIG)
    with pytest.raises(InvalidInput, match=r"pip install 'coilcal\[urdf\]'"):
        load_rig(tmp_path / "rig.yaml")
