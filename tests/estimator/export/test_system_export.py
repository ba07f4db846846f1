"""Several calibrations exported as one magnet, against the system that they make."""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.export.request import Grid
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.system.system import System
from tests.estimator.export.compared import Question, assert_close, needs_gcc, needs_octave

ONE = """
schema_version: 1
name: one
movers: {stage: {motion: displacement}, arm: {motion: UR3e, world_from_base: {x_mm: -415, y_mm: 131, z_mm: -481}}}
coils:
  left:
    carried_by: stage
    radius_mm: {value: 50, prior: {normal: {mean: 50, sd: 0.1}}}
    wire_radius_mm: 0.5
    axial_loops: 20
    radial_loops: 6
    world_from_coil0: {x_mm: -60, ry_deg: 90}
  unused: {radius_mm: 30, wire_radius_mm: 0.5, axial_loops: 3, radial_loops: 3, world_from_coil: {z_mm: -90}}
  far:
    carried_by: arm
    radius_mm: 40
    wire_radius_mm: 0.5
    axial_loops: 10
    radial_loops: 4
    flange_from_coil: {z_mm: 70}
sensors: {hall: {noise_uT: 20}}
effects:
  background_field[room]: {x_T: 2e-5, y_T: -1e-5, z_T: 4e-5}
  neighbour_coil[far]: {share: 0.03}
"""
TWO = """
schema_version: 1
name: two
movers: {stage: {motion: displacement}}
coils:
  right:
    carried_by: stage
    radius_mm: {value: 45, prior: {normal: {mean: 45, sd: 0.2}}}
    wire_radius_mm: 0.4
    axial_loops: 25
    radial_loops: 8
    current_gain: 0.97
    world_from_coil0: {x_mm: 60, ry_deg: -90, tilt_x_deg: {prior: {normal: {mean: 1, sd: 0.2}}}}
sensors: {hall: {noise_uT: 10}}
effects:
  background_field[room]: {x_T: 9e-5, y_T: 0, z_T: 0}
  current_offset[right]: {offset_A: 0.02}
"""
CURRENTS_A = {"left": 2.0, "far": 1.5, "right": -3.0}
MOTION = {
    "stage": torch.tensor([0.01, -0.005, 0.003, 0.05, 0.02, -0.1]).double(),
    "arm": torch.tensor(np.deg2rad([0.0, -90.0, -90.0, 0.0, 90.0, 10.0])),
}
POINTS_M = torch.from_numpy(np.random.default_rng(8).uniform(-0.04, 0.04, (9, 3)))
QUESTION = Question(POINTS_M, CURRENTS_A, MOTION)


@pytest.fixture(scope="module")
def system(calibrated: Callable[[Rig], Calibration]) -> System:
    """Coils left and far of one calibration, in which a third one was off, and right of another."""
    one, two = calibrated(rig_from_text(ONE)), calibrated(rig_from_text(TWO))
    readings = one.observations
    off = replace(readings, current_A=readings.current_A * torch.tensor([1.0, 0.0, 1.0]).double())
    return System.of(replace(one, observations=off), two)


@pytest.fixture(scope="module")
def expected(system: System) -> tuple[Tensor, Tensor, Tensor]:
    """Field, gradient and actuation matrix."""
    here, current_A = system.at(POINTS_M, MOTION), system.currents(CURRENTS_A)
    return here.field_T(current_A), here.gradient_T_per_m(current_A), here.actuation()


def check(rows: np.ndarray, expected: tuple[Tensor, Tensor, Tensor]) -> None:
    assert_close(rows[:, :3], expected[0])
    assert_close(rows[:, 3:12], expected[1])
    for part, rows_of_matrix in ((slice(0, 3), slice(12, 21)), (slice(3, 8), slice(21, 36))):
        assert_close(rows[:, rows_of_matrix], expected[2][:, part])


@needs_gcc
def test_header_is_the_system(system, expected, tmp_path):
    assert system.coils == ("left", "far", "right")
    rows = QUESTION.by_gcc(system, "one_and_two", tmp_path)
    check(rows, expected)
    lower_T, upper_T = system.at(POINTS_M, MOTION).field_interval_T(system.currents(CURRENTS_A), 0.6827)
    ratio = rows[:, 36:] / (0.5 * (upper_T - lower_T)).numpy()  # of 400 draws
    assert np.abs(ratio - 1.0).max() < 0.2
    assert abs(ratio.mean() - 1.0) < 0.1


@needs_octave
def test_octave_finds_the_system(system, expected, tmp_path):
    check(QUESTION.by_octave(system, tmp_path), expected)


def test_json_has_all_coils_and_tells_like_parameters_apart(system, tmp_path):
    document = json.loads(system.export("json", tmp_path / "both.json").read_text())
    assert [coil["name"] for coil in document["coils"]] == ["left", "far", "right"]
    assert [coil["mover"] for coil in document["coils"]] == ["stage", "arm", "stage"]
    assert document["parameters"]["hall.noise_T (left, far)"]["value"] == pytest.approx(20e-6)
    assert document["parameters"]["hall.noise_T (right)"]["value"] == pytest.approx(10e-6)
    assert document["parameters"]["right.radius_m"]["value"] == pytest.approx(0.045)
    assert document["background_T"] == [2e-5, -1e-5, 4e-5]  # of the first calibration
    matrix, offset_A = np.array(document["delivered_A_per_A"]), document["offset_A"]
    np.testing.assert_allclose(np.diag(matrix), [1.0, 1.0, 0.97])
    assert matrix[1, 0] == pytest.approx(0.03)
    assert offset_A == [0.0, 0.0, pytest.approx(0.02 * 0.97, rel=0.04)]


def test_grids_add_the_coils_up(system, tmp_path):
    grid = Grid(np.array([-0.01, 0.01]), np.array([0.0, 0.01]), np.array([0.0, 0.02]))
    path = system.export("csv", tmp_path / "both.csv", grid=grid, currents_A=CURRENTS_A, motion=MOTION)
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    expected_T = system.at(grid.points_m, MOTION).field_T(system.currents(CURRENTS_A))
    np.testing.assert_allclose(rows[:, 3:6], expected_T.numpy(), rtol=1e-12, atol=1e-15)


def test_what_holds_one_calibration_is_refused_and_so_is_an_unknown_name(system, tmp_path):
    with pytest.raises(InvalidInput, match="export to urdf must have one calibration; received 2"):
        system.export("urdf", tmp_path / "both.urdf")
    grid = Grid(np.zeros(1), np.zeros(1), np.zeros(1))
    with pytest.raises(InvalidInput, match=r"currents must name coils of the magnet .*; received 'unused'"):
        system.export("csv", tmp_path / "both.csv", grid=grid, currents_A={"unused": 1.0}, motion=MOTION)
    with pytest.raises(InvalidInput, match=r"motion must name movers of the rig .*; received 'leg'"):
        system.export("magpylib", tmp_path / "both.py", motion={"leg": torch.zeros(6).double()})


def test_magpylib_makes_the_same_field(system: System, tmp_path: Path) -> None:
    """It sums every loop; `coilcal predict` sums them to 1e-6 of the field."""
    path = system.export("magpylib", tmp_path / "both.py", motion=MOTION)
    field_T = runpy.run_path(str(path))["magnet"]([CURRENTS_A[name] for name in system.coils]).getB(
        POINTS_M.numpy()
    )
    expected_T = system.at(POINTS_M, MOTION).field_T(system.currents(CURRENTS_A)).numpy()
    size_T = np.linalg.norm(expected_T, axis=1)
    assert (np.linalg.norm(field_T - expected_T, axis=1) < 3e-6 * size_T).all()
