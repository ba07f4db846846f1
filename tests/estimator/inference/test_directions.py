"""Derivatives along few directions are those in every coordinate; sensors share directions, and what ties or exchanges them does not."""

from __future__ import annotations

import pytest
import torch

from estimator.derivatives import jacobian_of
from estimator.effects import EFFECTS
from estimator.inference.directions import EVERY, Directions
from estimator.rig.rig import Cause
from tests.estimator.inference.conftest import Problem, make_problem, posterior_with

COIL = "{c: {radius_mm: {prior: {normal: {mean: 45, sd: 2}}}, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 4}}"
SENSOR = "noise_uT: {prior: {log_normal: {median: 20, relative_sd: 0.5}}}, carried_by: stage"
SENSORS = f"{{one: {{{SENSOR}}}, two: {{{SENSOR}}}}}"
CAUSES = [Cause(name, place) for name in ("axis_gain", "sensor_misplaced") for place in ("one", "two")]


@pytest.fixture(scope="module")
def problem() -> Problem:
    return make_problem(COIL, SENSORS)


def test_shared_directions_give_the_derivatives_in_every_coordinate(problem):
    posterior = posterior_with(problem, *CAUSES)
    directions = Directions.of(posterior.model.rig, posterior.coordinates)
    n = posterior.coordinates.n_continuous
    n_own = sum(
        ".one" in name or "[one]" in name or name.startswith("one.") for name in posterior.coordinates.names
    )
    assert n_own > 9
    assert len(directions.each) == n - n_own  # those of the other sensor take the same ones
    assert directions.each.sum(0).tolist() == [1.0] * n
    vector = posterior.coordinates.start() + 1e-3
    found = posterior.to_first_order(vector)
    log_sigma = jacobian_of(lambda at: posterior.component_sigma_T(at).log(), vector)
    assert torch.allclose(found.log_sigma_jacobian, log_sigma, atol=1e-12)
    assert torch.allclose(found.jacobian_T, jacobian_of(posterior.predicted, vector), rtol=1e-9, atol=1e-12)


def test_what_may_change_readings_of_another_sensor_has_a_direction_of_its_own(problem):
    exchanged = posterior_with(
        problem, *CAUSES, Cause("sensors_exchanged", *EFFECTS["sensors_exchanged"].places(problem.rig))
    )
    directions = Directions.of(exchanged.model.rig, exchanged.coordinates)
    assert bool((directions.sensor == EVERY).all())
    assert len(directions.each) == len(directions.of_coordinate)


def test_derivatives_of_one_sensor_stay_in_the_order_of_the_coordinates():
    """Its noise stands before the causes of the room."""
    posterior = posterior_with(
        make_problem(COIL, f"{{one: {{{SENSOR}}}}}"), Cause("background_field", "room")
    )
    vector = posterior.coordinates.start() + 1e-3
    expected = jacobian_of(posterior.predicted, vector)
    assert torch.allclose(posterior.to_first_order(vector).jacobian_T, expected, rtol=1e-9, atol=1e-12)


def test_derivatives_in_some_coordinates_are_theirs(problem):
    """Two of them share a direction with others, and one comes before a coordinate that is numbered lower."""
    posterior = posterior_with(problem, *CAUSES)
    names = posterior.coordinates.names
    asked = ("c.radius_m", "one.noise_T", "axis_gain[two].y", "sensor_misplaced[one].x_m")
    columns = torch.tensor(sorted(names.index(name) for name in asked))
    vector = posterior.coordinates.start()[None] + 1e-3
    some, whole = posterior.to_first_order(vector, columns), posterior.to_first_order(vector)
    assert torch.allclose(some.jacobian_T, whole.jacobian_T[..., columns], rtol=1e-12, atol=0.0)
    assert torch.allclose(some.log_sigma_jacobian, whole.log_sigma_jacobian[..., columns], atol=1e-12)
    assert torch.allclose(posterior.log_sigma_jacobian(vector), whole.log_sigma_jacobian, atol=1e-12)


@pytest.mark.parametrize("places", [("one",), ("one", "two")])
def test_derivatives_by_poses_may_go_through_the_points(problem, places):
    """With elements apart at some or all sensors, each component has a point of its own."""
    apart = [Cause("element_displacement", place) for place in places]
    posterior = posterior_with(problem, *CAUSES, *apart, Cause("robot_shear", "stage"))
    vector = posterior.coordinates.start() + 1e-3 * posterior.coordinates.scale
    expected = jacobian_of(posterior.predicted, vector)
    assert torch.allclose(posterior.to_first_order(vector).jacobian_T, expected, rtol=1e-9, atol=1e-12)
