"""Windings with straight sides and coils with leads for other programs: JSON with a reader of its own, magpylib, g++, Octave, PyTorch."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from typing import Any

import jsonschema
import magpylib
import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.export.json_model import calibration_schema
from estimator.export.magnet import Magnet
from estimator.export.torch_program import MagnetProgram
from estimator.model.room_field import RoomField
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from tests.estimator.export.compared import Question, needs_gcc, needs_octave
from tests.estimator.field.test_sided import MAGPYLIB_OVER_OURS, outline

TEXT = """
schema_version: 1
name: three shapes
movers: {stage: {motion: pose}}
coils:
  sharp: {model: rectangular, carried_by: stage, inner_side_x_mm: {value: 60, prior: {normal: {mean: 60, sd: 0.1}}},
          inner_side_y_mm: 40, wire_radius_mm: 0.5, axial_loops: 4, radial_loops: 3, flange_from_coil: {y_mm: 70, rx_deg: 40}}
  rounded: {model: racetrack, lead_in_mm: [[300, 0, 5], [45, 0, 3]], lead_out_mm: [[45, 0, 0], [300, 5, 0], [300, 50, 0]],
            inner_side_x_mm: 80, inner_side_y_mm: 50, inner_corner_radius_mm: 12,
            wire_radius_mm: {value: 0.5, prior: {normal: {mean: 0.5, sd: 0.001}}}, axial_loops: 3, radial_loops: 2,
            world_from_coil: {x_mm: -60, ry_deg: 80}}
  circle: {lead_in_mm: [[300, 0, 5], [45, 0, 3]], lead_out_mm: [[45, 0, 0], [300, 5, 0]], radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 3, world_from_coil: {z_mm: -50}}
sensors: {hall: {noise_uT: 20}}
"""
CURRENTS_A = {"sharp": 3.0, "rounded": -2.0, "circle": 1.0}


@pytest.fixture(scope="module")
def magnet(calibrated: Callable[[Rig], Calibration]) -> Calibration:
    return calibrated(rig_from_text(TEXT))


@pytest.fixture(scope="module")
def points_m() -> Tensor:
    return torch.from_numpy(np.random.default_rng(0).uniform(-0.025, 0.025, (12, 3)))


MOTION = {"stage": torch.tensor([0.01, 0.0, -0.01, 0.1, 0.2, 0.0], dtype=torch.float64)}


def test_json_follows_its_schema_and_holds_what_a_reader_needs(magnet, points_m, tmp_path):
    document = json.loads(magnet.export("json", tmp_path / "magnet.json").read_text())
    jsonschema.validate(document, calibration_schema())
    assert [coil.get("corners") for coil in document["coils"]] == ["sharp", "round", None]
    assert [len(change["winding"]) for change in document["directions"][0]["coils"]] == [7, 7, 5]
    for name, coil in zip(CURRENTS_A, document["coils"][:2], strict=False):
        at_m = torch.zeros(3, dtype=torch.float64) if name == "rounded" else points_m
        expected_T = magnet.field(at_m.reshape(-1, 3), {name: 1.0}, {"stage": torch.zeros(6).double()})
        pose = coil["world_from_base"] if name == "rounded" else coil["flange_from_coil"]
        rotation, origin_m = np.array(pose["rotation"]), np.array(pose["translation_m"])
        at_coil_m = (at_m.reshape(-1, 3).numpy() - origin_m) @ rotation
        found_T = loops_T(coil, at_coil_m) @ rotation.T
        np.testing.assert_allclose(found_T, expected_T, rtol=0.0, atol=2e-5 * float(expected_T.abs().max()))


def loops_T(coil: dict[str, Any], points_m: np.ndarray) -> np.ndarray:
    """Field per ampere of every loop of the finest rule, by nothing but the file's conventions."""
    rule = max(coil["rules"], key=lambda each: len(each["axial_nodes"]) * len(each["radial_nodes"]))
    total = np.zeros_like(points_m)
    for axial, axial_weight in zip(rule["axial_nodes"], rule["axial_weights"], strict=True):
        for radial, radial_weight in zip(rule["radial_nodes"], rule["radial_weights"], strict=True):
            out_m = coil["radial_pitch_m"] * (coil["radial_loops"] / 2 + radial)
            corner_m = coil["corner_radius_m"] + out_m if coil["corners"] == "round" else 0.0
            half = [coil[f"side_{axis}_m"] / 2 + out_m for axis in "xy"]
            height_m = coil["axial_pitch_m"] * (axial - coil["axial_loops"] / 2)
            flat = outline(half[0], half[1], corner_m, 300 if corner_m else 1)
            wire = np.column_stack((flat, np.full(len(flat), height_m)))
            loop = magpylib.current.Polyline(vertices=wire, current=axial_weight * radial_weight)
            total += loop.getB(points_m) / MAGPYLIB_OVER_OURS
    for piece in coil["leads_m"]:
        total += magpylib.current.Polyline(vertices=piece, current=1.0).getB(points_m) / MAGPYLIB_OVER_OURS
    return total


def test_magpylib_has_the_field_of_all_loops(magnet, points_m, tmp_path):
    path = magnet.export("magpylib", tmp_path / "magnet.py", motion=MOTION)
    found_T = runpy.run_path(str(path))["magnet"](list(CURRENTS_A.values())).getB(points_m.numpy())
    whole = RoomField(magnet.rig, magnet.best_values(), points_m, MOTION, tolerance=0.0)
    expected_T = whole.field_T(magnet.best_values(), magnet.currents(CURRENTS_A)).numpy()
    np.testing.assert_allclose(found_T, expected_T, rtol=0.0, atol=3e-5 * np.abs(expected_T).max())
    assert "Arcs are 90 chords each" in path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def around_m() -> Tensor:
    """Points in the workspace, far away, beside wires and arcs, on the extension of a side, on an axis, and inside a winding."""
    rng = np.random.default_rng(1)
    spread_m = np.concatenate(
        (rng.uniform(-0.025, 0.025, (6, 3)), rng.normal(size=(3, 3)), 30.0 * rng.normal(size=(2, 3)))
    )
    beside_m = [
        [0.0, 0.0, 0.0],
        [0.0, 0.0, -0.02],
        [0.0405, 0.0, -0.049],
        [-0.0595, 0.0405, 0.0255],
        [-0.06, 0.03, 0.041],
    ]
    return torch.from_numpy(np.concatenate((spread_m, beside_m, [[0.0395, 0.0, -0.052]])))


@pytest.fixture
def question(around_m: Tensor) -> Question:
    return Question(around_m, CURRENTS_A, MOTION)


@needs_gcc
def test_cpp_has_field_gradient_and_standard_deviation(magnet, question, tmp_path):
    rows = question.by_gcc(magnet, "three_shapes", tmp_path)
    question.check(rows, magnet)
    question.check_deviation(rows, magnet, 11)


@needs_octave
def test_octave_has_field_and_gradient(magnet, question, tmp_path):
    question.check(question.by_octave(magnet, tmp_path), magnet)


@pytest.mark.parametrize("is_exported", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_program_of_torch_has_field_and_gradient(magnet, question, tmp_path, is_exported):
    """As the module that is exported, and as the file; `test_torch_program` runs one without coilcal."""
    program = MagnetProgram(Magnet.of(magnet).model("torch"))
    if is_exported:
        program = torch.export.load(magnet.export("torch", tmp_path / "magnet.pt2")).module()
    currents_A = torch.tensor(list(CURRENTS_A.values()), dtype=torch.float64)
    field_T, gradient = program(question.points_m, currents_A, MOTION["stage"][None])
    question.check(torch.cat((field_T, gradient.flatten(1)), dim=1).numpy(), magnet)
