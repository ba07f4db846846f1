"""Field maps made by magpylib as rivals of the coil model, on simulated readings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import magpylib
import numpy as np
import pytest
import torch
from scipy.interpolate import NdBSpline

from estimator.comparison.compare import Explained, compare
from estimator.comparison.map_files import read_map
from estimator.comparison.report import comparison_report
from estimator.errors import InvalidInput
from estimator.field.grid_map import GridMap
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session

pytestmark = pytest.mark.whole
RADIUS_M, PITCH_M, AXIAL, RADIAL = 0.0518, 1.96e-3, 13, 3
AXES_M = (np.linspace(-0.06, 0.06, 25), np.linspace(-0.06, 0.06, 25), np.linspace(0.005, 0.085, 17))


@cache
def made_by_magpylib() -> np.ndarray:
    """Field per ampere of every loop, by code of other people, on the grid."""
    loops = [
        magpylib.current.Circle(
            diameter=2.0 * (RADIUS_M - PITCH_M * (j + 0.5)),
            current=1.0,
            position=(0.0, 0.0, -PITCH_M * (i + 0.5)),
        )
        for i in range(AXIAL)
        for j in range(RADIAL)
    ]
    grid_m = np.stack(np.meshgrid(*AXES_M, indexing="ij"), axis=-1)
    field: np.ndarray = magpylib.getB(magpylib.Collection(loops), grid_m)
    return field


@pytest.fixture
def session(small_rig: Rig, small_plan: Plan, small_truth: dict[str, float]) -> Session:
    return Session(small_rig, simulate(small_rig, small_plan, small_truth, seed=1), "simulated")


def test_a_right_map_and_the_coil_model_both_explain_the_readings(session):
    comparison = compare(session, GridMap.of(AXES_M, made_by_magpylib()))
    assert comparison.explained is Explained.BOTH
    assert not comparison.is_coarse
    assert comparison.outside == 0
    assert comparison.map.lack_of_fit.rms_T == pytest.approx(5e-6, rel=0.2)
    assert comparison.improvement is not None
    assert abs(comparison.improvement.elpd_difference) < 3.0 * comparison.improvement.elpd_se + 1.0


def test_a_map_that_is_too_weak_does_not_explain_them_and_it_shows_everywhere(session):
    comparison = compare(session, GridMap.of(AXES_M, 0.9 * made_by_magpylib()))
    assert comparison.explained is Explained.COIL_MODEL
    assert comparison.improvement is not None
    assert comparison.improvement.elpd_difference < 0.0
    near, *_, far = comparison.shells
    assert all(shell.map_T > 1.2 * shell.coil_model_T for shell in comparison.shells)
    assert near.farthest_m < far.nearest_m
    assert sum(shell.readings for shell in comparison.shells) == len(session.observations.calibration)


def test_a_map_explains_what_the_coil_model_cannot(small_rig, small_plan, small_truth, rig_text):
    """A winding described as much too thick is held there by fixed numbers; the map has the right one."""
    readings = simulate(small_rig, small_plan, small_truth, seed=1)
    wrong = rig_from_text(
        rig_text.replace("axial_loops: {prior: {normal: {mean: 12, sd: 1, lower: 1}}}", "axial_loops: 10")
    )
    comparison = compare(Session(wrong, readings, "simulated"), GridMap.of(AXES_M, made_by_magpylib()))
    assert comparison.explained is Explained.MAP
    assert comparison.improvement is not None
    assert comparison.improvement.is_significant


def test_a_gain_that_nobody_described_leaves_both_unexplained(session):
    readings = session.observations
    wrong = replace(readings, field_sensor_T=readings.field_sensor_T * torch.tensor([1.05, 1.0, 1.0]))
    comparison = compare(replace(session, observations=wrong), GridMap.of(AXES_M, made_by_magpylib()))
    assert comparison.explained is Explained.NEITHER
    page = comparison_report(comparison, "a test", "coilcal compare")
    assert "Neither the map nor the coil model explains the readings." in page
    assert "The residual of the map goes most with: " in page


def test_readings_beyond_the_map_are_left_out_and_counted(session):
    half = (AXES_M[0], AXES_M[1], AXES_M[2][:9])
    comparison = compare(session, GridMap.of(half, made_by_magpylib()[:, :, :9]))
    assert 0 < comparison.outside < len(session.observations)
    assert len(comparison.map.fit.observations) < len(session.observations.calibration)
    tiny = tuple(1e-3 * axis_m for axis_m in AXES_M)
    with pytest.raises(InvalidInput, match="must hold at least 10 readings for the fit; it holds 0"):
        compare(session, GridMap.of((tiny[0], tiny[1], tiny[2]), made_by_magpylib()))


def test_spline_is_that_of_scipy_and_its_slope_the_difference():
    field_map = GridMap.of(AXES_M, made_by_magpylib())
    rng = np.random.default_rng(0)
    points_m = rng.uniform([-0.06, -0.06, 0.005], [0.06, 0.06, 0.085], (20, 3))
    scipys = NdBSpline(tuple(knots.numpy() for knots in field_map.knots_m), field_map.coefficients.numpy(), 3)
    np.testing.assert_allclose(
        field_map.field(torch.from_numpy(points_m)), scipys(points_m), rtol=1e-10, atol=1e-18
    )
    at_grid = field_map.field(torch.tensor([[AXES_M[0][3], AXES_M[1][12], AXES_M[2][0]]]))
    np.testing.assert_allclose(at_grid[0], made_by_magpylib()[3, 12, 0], rtol=1e-12, atol=1e-18)
    step = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    _, slope = torch.func.jvp(field_map.field, (torch.from_numpy(points_m),), (step.expand(20, 3),))
    ahead, behind = (field_map.field(torch.from_numpy(points_m) + sign * 1e-6 * step) for sign in (1, -1))
    np.testing.assert_allclose(slope, (ahead - behind) / 2e-6, rtol=1e-5, atol=1e-9)


COMSOL_CSV = """% Model,coil.mph
% Version,COMSOL 6.1.0.252
% Date,"Mar 13 2023, 16:27"
% Dimension,3
% Nodes,343
% Expressions,3
% Description,"Magnetic flux density, x-component, Magnetic flux density, y-component, Magnetic flux density, z-component"
% Length unit,µm
% x,y,z,mf.Bx (mT) @ I0=3,mf.By (mT) @ I0=3,mf.Bz (mT) @ I0=3
"""
COMSOL_TEXT = """% Model:              coil.mph
% Version:            COMSOL 6.1.0.252
% Date:               Mar 13 2023, 16:27
% Dimension:          3
% Nodes:              343
% Expressions:        3
% Description:        Magnetic flux density, x-component, Magnetic flux density, y-component, Magnetic flux density, z-component
% Length unit:        mm
% X                       Y                        Z                        mf.Bx (T)                mf.By (T)                mf.Bz (T)
"""


@pytest.mark.parametrize(
    ("header", "separator", "to_length", "to_field"),
    [(COMSOL_CSV, ",", 1e6, 1e3), (COMSOL_TEXT, "       ", 1e3, 1.0)],
    ids=["csv", "text"],
)
def test_what_comsol_exports_is_read_with_its_whole_header(header, separator, to_length, to_field, tmp_path):
    """Headers as its spreadsheet format has them, as CSV and as text; x runs fastest."""
    axis_m = np.linspace(-0.03, 0.03, 7)
    z, y, x = np.meshgrid(axis_m + 0.05, axis_m, axis_m, indexing="ij")
    points_m = np.stack((x, y, z), axis=-1).reshape(-1, 3)
    field_T = 1e-3 * np.stack((points_m[:, 0], 2.0 * points_m[:, 1], 1.0 - 3.0 * points_m[:, 2]), axis=-1)
    rows = np.hstack((to_length * points_m, to_field * field_T))
    path = tmp_path / "fem.csv"
    lines = (separator.join(f"{number:.17g}" for number in row) for row in rows)
    path.write_text(header + "\n".join(lines) + "\n", encoding="utf-8")
    there_m = torch.tensor([[0.004, -0.01, 0.055]], dtype=torch.float64)
    expected = 1e-3 * np.array([[0.004, -0.02, 1.0 - 0.165]]) / 3.0
    np.testing.assert_allclose(read_map(path, 3.0).field(there_m).numpy(), expected, rtol=1e-9)


def test_comsol_and_plain_csv_give_the_same_map(tmp_path):
    grid_mm = 1e3 * np.stack(np.meshgrid(*AXES_M, indexing="ij"), axis=-1).reshape(-1, 3)
    rows = np.hstack((grid_mm, 2.0 * made_by_magpylib().reshape(-1, 3)))[::-1]  # at 2 A, in another order
    comsol, plain = tmp_path / "comsol.csv", tmp_path / "plain.csv"
    head = "% Model,coil.mph\n% Length unit,mm\n% x,y,z,mf.Bx (T),mf.By (T),mf.Bz (T)"
    np.savetxt(comsol, rows, fmt="%.17g", delimiter=",", header=head, comments="")
    np.savetxt(
        plain,
        rows * [1, 1, 1, 1e3, 1e3, 1e3],
        fmt="%.17g",
        delimiter=",",
        header="x_mm,y_mm,z_mm,Bx_mT,By_mT,Bz_mT",
        comments="",
    )
    for path in (comsol, plain):
        field_map = read_map(path, 2.0)
        np.testing.assert_allclose(field_map.values, made_by_magpylib(), rtol=1e-12)
        np.testing.assert_allclose(field_map.axes_m[2], AXES_M[2], rtol=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x_mm,y_mm,z_mm,Bx_T,By_T\n0,0,0,1,1\n", "Bz is missing"),
        ("x,y_mm,z_mm,Bx_T,By_T,Bz_T\n", "must have a unit, as x_mm or Bx (T); received 'x'"),
        ("x_mm,y_mm,z_mm,Bx_T,By_T,Bz_T\n0,0,0,1,1,a\n", "must hold numbers; received '0,0,0,1,1,a'"),
        (
            "x_mm,y_mm,z_mm,Bx_T,By_T,Bz_T\n0,0,0,1,1,nan\n",
            "must hold finite numbers between -1e+12 and 1e+12; 1 rows do not",
        ),
        ("x_mm,y_mm,z_mm,Bx_T,By_T,Bz_T\n0,0,0,1,1,1\n1,1,0,1,1,1\n", "has 2 rows for 2 x 2 x 1 points"),
        ("x_mm,y_mm,z_mm,Bx_T,By_T,Bz_T\n0,0,0,1,1,1\n", "at least 7 points along x; received 1"),
        ("", "x is missing"),
    ],
)
def test_a_file_that_is_no_map_is_refused(text, said, tmp_path):
    (tmp_path / "map.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput) as refused:
        read_map(tmp_path / "map.csv", 1.0)
    assert said in str(refused.value)
