"""Climbs with secants reach the maxima of exact climbs, with the same curvature, by fewer Jacobians."""

from __future__ import annotations

from unittest.mock import patch

import pytest
import torch

from estimator.inference.laplace import log_evidence
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.inference.secant import climb_with_secants
from estimator.rig.rig import Cause
from tests.estimator.inference.conftest import Problem, make_problem, posterior_with

pytestmark = pytest.mark.whole

COIL = """{c: {radius_mm: {prior: {normal: {mean: 45, sd: 2}}}, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 4, world_from_coil:
  {x_mm: {prior: {normal: {mean: 0, sd: 3}}}, z_mm: {prior: {normal: {mean: -35, sd: 3, lower: -38, upper: -33}}}}}}"""
SENSOR = "noise_uT: {prior: {log_normal: {median: 0.5, relative_sd: 0.5}}}, carried_by: stage"
TRUTH = {"c.world_from_coil.x_m": 0.004, "c.radius_m": 0.047, "c.world_from_coil.z_m": -0.0341}
SENSOR_CAUSES = tuple(
    Cause(name, place)
    for place in ("one", "two")
    for name in ("axis_gain", "sensor_misplaced", "sensor_offset", "element_displacement")
)
ROBUST, WIDER = Cause("outliers", "one"), Cause("position_jitter", "stage")
TOLERANCE = 1e-6


@pytest.fixture(scope="module")
def problem() -> Problem:
    return make_problem(COIL, f"{{one: {{{SENSOR}}}, two: {{{SENSOR}}}}}", TRUTH, noise_T=0.6e-6)


def assert_same_maximum(found: Optimum, exact: Optimum) -> None:
    assert found.is_converged.all()
    assert exact.is_converged.all()
    assert float(found.log_posterior) == pytest.approx(float(exact.log_posterior), abs=1e-3)
    sd = torch.linalg.inv(exact.precision[0]).diagonal().sqrt()
    n = len(sd)
    assert ((found.vector - exact.vector)[0, :n].abs() < 0.05 * sd).all()
    assert float(log_evidence(found)[0]) == pytest.approx(float(log_evidence(exact)[0]), abs=0.02)


@pytest.mark.parametrize("more", [(), (WIDER,), (ROBUST,)], ids=["free noise", "jitter", "outliers"])
def test_maximum_and_curvature_are_those_of_exact_jacobians(problem, more):
    posterior = posterior_with(problem, *SENSOR_CAUSES, *more)
    start = posterior.coordinates.start()[None]
    found = climb_with_secants(posterior, start, TOLERANCE)
    assert_same_maximum(found, levenberg_marquardt(posterior, start, tolerance=TOLERANCE))
    exact = posterior.to_first_order(found.vector)
    assert found.slopes is not None
    assert torch.equal(found.slopes.jacobian_T, exact.jacobian_T)
    assert torch.equal(found.slopes.log_sigma_jacobian, exact.log_sigma_jacobian)
    torch.testing.assert_close(found.log_posterior, posterior(found.vector), rtol=0.0, atol=0.0)


def test_few_jacobians_are_made(problem):
    posterior = posterior_with(problem, *SENSOR_CAUSES)
    start = posterior.coordinates.start()[None]
    with patch.object(
        LogPosterior, "to_first_order", autospec=True, side_effect=LogPosterior.to_first_order
    ) as made:
        found = climb_with_secants(posterior, start, TOLERANCE)
        n_with_secants = made.call_count
        exact = levenberg_marquardt(posterior, start, tolerance=TOLERANCE)
        n_exact = made.call_count - n_with_secants
    assert exact.n_iterations > 4
    assert n_with_secants < 0.7 * n_exact
    assert found.n_iterations > n_with_secants


def test_maximum_at_a_bound(problem):
    """Readings of a coil 1.5 mm beyond the bound."""
    shifted = make_problem(
        COIL.replace("lower: -38, upper: -33", "lower: -60, upper: -10"),
        f"{{one: {{{SENSOR}}}, two: {{{SENSOR}}}}}",
        TRUTH | {"c.world_from_coil.z_m": -0.0395},
        noise_T=0.6e-6,
    )
    asked = Problem(problem.rig, shifted.observations, shifted.truth, problem.real, problem.whole)
    posterior = posterior_with(asked, *SENSOR_CAUSES)
    start = posterior.coordinates.start()[None]
    found = climb_with_secants(posterior, start, TOLERANCE)
    exact = levenberg_marquardt(posterior, start, tolerance=TOLERANCE)
    assert found.is_converged.all()
    assert float(posterior.coordinates.values(found.vector[0])["c.world_from_coil.z_m"]) < -0.0379
    assert float(found.log_posterior) > float(exact.log_posterior) - 0.05


def test_a_wrong_jacobian_at_the_start_leads_to_the_same_maximum(problem):
    posterior = posterior_with(problem, *SENSOR_CAUSES)
    start = posterior.coordinates.start()[None]
    slopes = posterior.to_first_order(start)
    wrong = slopes._replace(
        jacobian_T=slopes.jacobian_T * torch.linspace(0.5, 1.5, slopes.jacobian_T.shape[-1])
    )
    found = climb_with_secants(posterior, start, TOLERANCE, wrong)
    assert_same_maximum(found, levenberg_marquardt(posterior, start, tolerance=TOLERANCE))


def test_a_start_that_rounding_left_outside_the_prior_climbs_all_the_same(problem):
    posterior = posterior_with(problem, *SENSOR_CAUSES)
    start = posterior.coordinates.start()[None]
    exact = climb_with_secants(posterior, start, TOLERANCE)
    column = posterior.coordinates.names.index("c.world_from_coil.z_m")
    outside = exact.vector.clone()
    outside[:, column] = -0.033 + 1e-15  # the bound is -33 mm
    assert posterior(outside).isneginf().all()
    assert_same_maximum(climb_with_secants(posterior, outside, TOLERANCE), exact)
