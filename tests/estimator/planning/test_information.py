"""What stops are expected to say, against finite differences, laws of noise, and posteriors of simulated readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.calibration.calibrate import calibrate
from estimator.model.measurement_model import MeasurementModel
from estimator.model.simulate import simulate
from estimator.planning.candidates import candidates_of, possible
from estimator.planning.design import Design
from estimator.planning.goals import goal_of
from estimator.planning.information import Expected, draws_of_prior, is_clear, known_coordinates
from estimator.readings.plan import load_plan, plan_from_text, plan_text
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig
from estimator.store.session import Session
from tests.estimator.conftest import SETTINGS

BOX = "field 1 % in box x_mm=-50:50 y_mm=-50:50 z_mm=-25:25"


@pytest.fixture(scope="module")
def paper() -> tuple[Rig, Expected]:
    """The coil of the paper and the 125 places of its raster, at draws of the prior."""
    rig = load_rig("configs/paper_simulation.yaml")
    grid = replace(load_plan("configs/plans/paper_grid.yaml", rig), validation=())
    stops = candidates_of(grid, rig, 0)
    return rig, Expected.of(rig, stops, [goal_of(BOX, rig, {"coil1": 3.0})], draws_of_prior(rig, 24, 0))


def test_information_is_that_of_finite_differences(small_rig, small_plan):
    stops = candidates_of(small_plan, small_rig, 0)
    coordinates = Coordinates(small_rig)
    at = draws_of_prior(small_rig, 3, 1)
    expected = Expected.of(small_rig, stops, [], at)
    model = MeasurementModel.build(small_rig, stops)
    step = 1e-5 * coordinates.scale
    for draw, vector in enumerate(at):
        around = torch.cat((vector + torch.diag(step), vector - torch.diag(step)))
        up_T, down_T = model.predict(coordinates.values(around)).flatten(1).chunk(2)
        columns = ((up_T - down_T) / (2.0 * step[:, None])).mT / 5e-6
        torch.testing.assert_close(
            expected.information(torch.arange(len(stops)))[draw], columns.mT @ columns, rtol=1e-5, atol=1e-3
        )


def test_rows_of_a_goal_are_those_of_finite_differences(paper):
    rig, expected = paper
    coordinates, at = Coordinates(rig), expected.at[:2]
    texts = (
        BOX,
        "field 5 uT worst in ball r_mm=20",
        "parameters coil1.radius_m 0.1 mm coil1.radial_loops 10 %",
    )
    for text in texts:
        goal = goal_of(text, rig, {"coil1": 3.0})
        rows = goal.rows(coordinates, at)
        assert rows.shape[:2] == (2, rows.shape[1])
        if text.startswith("parameters"):
            radius = coordinates.names.index("coil1.radius_m")
            slopes = [coordinates.slopes_of_values(vector)[radius] for vector in at]
            torch.testing.assert_close(rows[:, 0], torch.stack(slopes) * 1.644854 / 1e-4)
            assert goal.half_widths["coil1.radial_loops"] == pytest.approx(2.2)


@pytest.mark.whole
def test_a_third_of_the_raster_s_stops_reach_its_interval_of_the_field(paper):
    _, expected = paper
    raster = float(expected.widths(expected.precision + expected.information(torch.arange(125))).median())
    design = Design(expected)
    design.grow(38)
    design.exchange()
    assert len(set(design.chosen)) < 25
    assert float(design.widths) < raster
    design.grow(125)
    assert float(design.widths) < 0.6 * raster


def test_the_determinant_grows_at_least_as_with_any_other_stops(small_rig, small_plan):
    stops = candidates_of(small_plan, small_rig, 0)
    expected = Expected.of(small_rig, stops, [], draws_of_prior(small_rig, 8, 0))
    design = Design(expected)
    design.grow(6)
    design.exchange()
    rng = np.random.default_rng(0)
    others = [torch.from_numpy(rng.choice(len(stops), 6)) for _ in range(100)]
    volumes = [torch.logdet(expected.precision + expected.information(rows)).mean() for rows in others]
    assert torch.logdet(design.precision).mean() >= max(volumes)


@pytest.mark.whole
def test_a_sampled_posterior_has_the_expected_widths(small_rig, small_plan):
    stops = candidates_of(small_plan, small_rig, 0)
    truth = {"coil1.radius_m": 0.0515, "coil1.axial_loops": 12.4, "coil1.world_from_coil0.z_m": -0.041}
    coordinates = Coordinates(small_rig)
    at = coordinates.vector(truth)[None]
    expected = Expected.of(small_rig, stops, [], at)
    design = Design(expected)
    design.grow(12)
    chosen = stops.rows(torch.tensor(design.chosen)).alone
    plan = plan_from_text(plan_text("chosen", small_rig, chosen, 1.0), small_rig)
    session = Session(small_rig, simulate(small_rig, plan, truth, seed=3), source="simulated")
    calibration = calibrate(session, settings=SETTINGS, seed=1, as_described=True, has_integer_counts=False)
    vectors = coordinates.vector(
        {n: torch.from_numpy(calibration.draws[n].ravel()) for n in coordinates.names}
    )
    sampled = torch.cov(vectors.mT).diagonal().sqrt()
    predicted = torch.linalg.inv(design.precision)[0].diagonal().sqrt()
    torch.testing.assert_close(sampled, predicted, rtol=0.2, atol=0.0)


def test_stops_that_may_lie_in_a_winding_are_no_candidates(small_rig):
    text = """
schema_version: 1
name: through the winding
poses: {calibration: {arm1: {y_mm: 48, z_mm: {from: -20, to: 46, count: 12}}}}
currents_A: [{coil1: 3}, {coil1: -3}]
"""
    at = draws_of_prior(small_rig, 64, 0)
    stops = candidates_of(plan_from_text(text, small_rig), small_rig, 0)
    left = possible(stops, small_rig, at)
    z_mm = set(left.motion["arm1"][:, 2].mul(1e3).round().tolist())
    assert 0 < len(left) < len(stops)
    assert min(z_mm) == -20.0
    clear_at_nominal = is_clear(small_rig, stops, at[:0])
    assert len(left) < int(clear_at_nominal.sum()) < len(stops)


def test_noise_is_no_coordinate_of_a_plan(paper):
    rig, expected = paper
    names = [Coordinates(rig).names[i] for i in known_coordinates(Coordinates(rig))]
    assert "hall.noise_T" not in names
    assert expected.precision.shape[-1] == len(names) == len(rig.free) - 1
