"""Levenberg-Marquardt: maxima that SciPy finds too, with the curvature that finite differences have."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
import torch
from torch import Tensor

from estimator import draw_truth, load_plan, load_rig, simulate
from estimator.inference.levenberg_marquardt import (
    LEAST_CURVATURE,
    Optimum,
    levenberg_marquardt,
    prior_gradient,
    prior_gradient_and_precision,
)
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import Coordinates
from estimator.rig.parameters import Prior
from estimator.rig.rig import Cause
from scripts.benchmarks.diagnose import CONFIGS, PLAN
from scripts.paper.solvers import Problem as SolverProblem
from scripts.paper.tables import TRUTH
from tests.estimator.inference.conftest import posterior_with

pytestmark = pytest.mark.whole


def gradient(posterior: LogPosterior, vector: Tensor) -> Tensor:
    """By central differences, in units of the prior."""
    shifts = torch.diag(1e-5 * posterior.coordinates.scale)
    return (posterior(vector + shifts) - posterior(vector - shifts)) / 2e-5


def hessian(posterior: LogPosterior, vector: Tensor, step: Tensor) -> Tensor:
    """By central differences, in units of the steps."""
    n = len(vector)
    shifts = torch.diag(step)
    pairs = torch.stack([a * shifts[i] + b * shifts[j] for i in range(n) for j in range(n) for a, b in SIGNS])
    ends = posterior(vector + pairs).reshape(n, n, 4)
    return 0.25 * (ends * torch.tensor([1.0, -1.0, -1.0, 1.0]).double()).sum(-1)


SIGNS = ((1, 1), (1, -1), (-1, 1), (-1, -1))


@pytest.fixture(scope="module")
def starts(winding_problem) -> Tensor:
    """No count of them is 1, the bound of its prior: rounding decides whether such a start lies inside."""
    random = np.random.default_rng(4)
    draws = winding_problem.real.coordinates.sample_prior(random, 6)
    values = winding_problem.real.coordinates.values(draws)
    assert all((values[f"coil1.{key}_loops"] > 1.5).all() for key in ("axial", "radial"))
    return torch.cat((winding_problem.real.coordinates.start()[None], draws))


@pytest.fixture(scope="module")
def fits(winding_problem, starts) -> Optimum:
    return levenberg_marquardt(winding_problem.real, starts)


def test_every_start_climbs_to_the_same_maximum(winding_problem, starts, fits):
    assert fits.is_converged.all()
    assert (fits.log_posterior > winding_problem.real(starts) + 10.0).all()
    torch.testing.assert_close(fits.log_posterior, winding_problem.real(fits.vector), rtol=1e-12, atol=0.0)
    assert fits.log_posterior.max() - fits.log_posterior.min() < 1e-6
    apart = (fits.vector - fits.vector[0]).abs() / winding_problem.real.coordinates.scale
    assert apart.max() < 1e-3


def test_scipy_finds_no_higher_point_and_comes_back_to_the_maximum(winding_problem, fits):
    """SciPy sees nothing but values of the density, starts three of the posterior's standard deviations away and uses BFGS."""
    posterior = winding_problem.real
    factor = torch.linalg.cholesky(torch.linalg.inv(fits.precision[0]))

    def cost(white: np.ndarray) -> tuple[float, np.ndarray]:
        at = torch.from_numpy(white)
        shifts = 1e-4 * torch.eye(len(at), dtype=torch.float64)
        values = posterior(fits.vector[0] + torch.cat((at[None], at + shifts, at - shifts)) @ factor.T)
        here, up, down = values[0], *values[1:].chunk(2)
        return (fits.log_posterior[0] - here).item(), ((down - up) / 2e-4).numpy()

    random = np.random.default_rng(4).normal(size=len(factor))
    scipy_result = scipy.optimize.minimize(
        cost, 3.0 * random / np.linalg.norm(random), jac=True, method="BFGS", options={"gtol": 1e-4}
    )
    assert -1e-6 < scipy_result.fun < 1e-6
    assert np.abs(scipy_result.x).max() < 2e-3


def test_precision_is_the_negative_hessian_where_residuals_are_small(problem):
    """Gauss-Newton leaves out residual times second derivative: nothing on perfect readings, and the noise is fixed here."""
    simulated = problem(
        """{coil1: {radius_mm: {prior: {normal: {mean: 51, sd: 1}}}, wire_radius_mm: 0.9, axial_loops: 6,
  radial_loops: {prior: {normal: {mean: 4, sd: 0.3, lower: 1}}},
  world_from_coil: {x_mm: {prior: {normal: {mean: 0, sd: 3}}}, z_mm: {prior: {normal: {mean: -35, sd: 3}}},
    tilt_y_deg: {prior: {normal: {mean: 0, sd: 2}}}}}}""",
        "{hall: {noise_uT: 0.5, carried_by: stage}}",
        noise_T=0.0,
    )
    fit = levenberg_marquardt(
        simulated.real, simulated.real.coordinates.sample_prior(np.random.default_rng(5), 1)
    )
    sd = torch.linalg.inv(fit.precision[0]).diagonal().sqrt()
    numerical = -hessian(simulated.real, fit.vector[0], 0.05 * sd) / 0.05**2
    ours = fit.precision[0] * sd[:, None] * sd[None, :]
    torch.testing.assert_close(ours, numerical, rtol=1e-3, atol=1e-3 * ours.abs().max().item())
    assert (ours - ours.diagonal().diag()).abs().max() > 0.1


@pytest.mark.parametrize("causes", [(), ("axis_gain", "noise_grows", "sensor_offset")])
def test_curvature_of_the_prior_is_its_hessian_where_only_coordinates_of_windings_are_coupled(
    winding_problem, causes
):
    posterior = posterior_with(winding_problem, *(Cause(name, "hall") for name in causes))
    coordinates = posterior.coordinates
    vector = coordinates.start() + 1e-3 * coordinates.scale
    hessian = torch.autograd.functional.hessian(coordinates.log_prior, vector)
    unit = coordinates.scale[:, None] * coordinates.scale
    eigenvalues, vectors = torch.linalg.eigh(-hessian * unit)
    expected = vectors @ torch.diag(eigenvalues.clamp(min=LEAST_CURVATURE)) @ vectors.mT / unit
    gradient, precision = prior_gradient_and_precision(coordinates, vector[None])
    assert torch.allclose(precision[0] * unit, expected * unit, rtol=1e-9, atol=1e-12)
    assert torch.allclose(gradient[0], prior_gradient(coordinates, vector), rtol=1e-12)
    assert 0 < len(coordinates.coupled) < coordinates.n
    assert bool((hessian != 0.0).sum(0)[coordinates.coupled].gt(1).any())  # windings couple theirs


def test_noise_is_fitted_with_its_full_curvature(winding_problem, fits):
    """Two per component at the best noise, and that of its prior: exact, not Gauss-Newton."""
    column = winding_problem.real.coordinates.names.index("hall.noise_T")
    step = torch.zeros_like(fits.vector[0])
    step[column] = 1e-3
    ends = winding_problem.real(torch.stack((fits.vector[0] + step, fits.vector[0], fits.vector[0] - step)))
    numerical = -(ends[0] - 2.0 * ends[1] + ends[2]).item() / 1e-6
    assert fits.precision[0, column, column].item() == pytest.approx(numerical, rel=1e-3)
    n_components = len(winding_problem.real.measured_T)
    assert fits.information[0, column, column].item() == pytest.approx(2.0 * n_components, rel=0.05)


def test_information_is_the_part_of_the_precision_that_the_prior_has_no_share_in(linear_problem):
    fit = levenberg_marquardt(linear_problem.real, linear_problem.real.coordinates.start()[None])
    prior = torch.diag(torch.full((2,), 1.0 / 0.05**2, dtype=torch.float64))
    torch.testing.assert_close(fit.precision[0] - fit.information[0], prior, rtol=1e-8, atol=1e-6)
    assert (fit.information[0].diagonal() > 1e4).all()


def test_linear_problem_is_solved_as_by_linear_algebra(linear_problem):
    """Ridge regression of the readings on the fields of the two coils."""
    posterior = linear_problem.real
    first, second = torch.eye(2).double()
    design = torch.stack((posterior.predicted(first), posterior.predicted(second)), -1) / 0.2e-6
    matrix = design.T @ design + torch.eye(2) / 0.05**2
    expected = torch.linalg.solve(matrix, design.T @ posterior.measured_T / 0.2e-6 + 1.0 / 0.05**2)
    fit = levenberg_marquardt(posterior, torch.tensor([[0.7, 1.4]]).double())
    torch.testing.assert_close(fit.vector[0], expected, rtol=1e-7, atol=0.0)
    torch.testing.assert_close(fit.precision[0], matrix, rtol=1e-9, atol=1e-6)


def test_starts_do_not_disturb_each_other(counts_problem):
    posterior = counts_problem.real
    starts = posterior.coordinates.sample_prior(np.random.default_rng(6), 3)
    together = levenberg_marquardt(posterior, starts)
    for i, start in enumerate(starts):
        alone = levenberg_marquardt(posterior, start[None])
        assert ((alone.vector[0] - together.vector[i]).abs() < 1e-4 * posterior.coordinates.scale).all()
        assert alone.log_posterior[0].item() == pytest.approx(together.log_posterior[i].item(), abs=1e-7)


def test_whole_numbered_counts_stay_where_they_are(counts_problem):
    posterior = counts_problem.whole
    start = posterior.coordinates.start()[None].repeat(3, 1)
    start[:, -2:] = torch.tensor([[6.0, 4.0], [7.0, 4.0], [8.0, 3.0]])
    fit = levenberg_marquardt(posterior, start)
    assert torch.equal(fit.vector[:, -2:], start[:, -2:])
    assert fit.is_converged.all()
    n = posterior.coordinates.n_continuous
    assert fit.precision.shape == fit.information.shape == (3, n, n)
    for vector in fit.vector:
        assert gradient(posterior, vector)[:n].norm() < 1e-3 * gradient(posterior, start[0])[:n].norm()


def test_too_few_iterations_are_reported_and_leave_no_worse_point(winding_problem, starts):
    fit = levenberg_marquardt(winding_problem.real, starts, max_iterations=2)
    assert fit.n_iterations == 2
    assert not fit.is_converged.all()
    assert (fit.log_posterior >= winding_problem.real(starts)).all()


def test_maximum_in_a_corner_of_curved_bounds_is_that_of_another_optimizer(problem):
    """Radius and pitches share coordinates, and readings of a larger, longer and thicker coil pull all of them to their bounds."""
    simulated = problem(
        """{coil1: {radius_mm: {prior: {normal: {mean: 51, sd: 1, lower: 49, upper: 51.5}}}, wire_radius_mm: 0.5,
  axial_pitch_mm: {prior: {normal: {mean: 1.2, sd: 0.05, lower: 1.1, upper: 1.25}}},
  radial_pitch_mm: {prior: {normal: {mean: 1.2, sd: 0.05, lower: 1.1, upper: 1.25}}}, axial_loops: 12, radial_loops: 20,
  world_from_coil: {z_mm: {prior: {normal: {mean: -40, sd: 1, lower: -41, upper: -39}}}}}}""",
        "{hall: {noise_uT: {prior: {log_normal: {median: 1, relative_sd: 1}}}, carried_by: stage}}",
        {
            "coil1.radius_m": 0.055,
            "coil1.radial_pitch_m": 0.0014,
            "coil1.axial_pitch_m": 0.0011,
            "coil1.world_from_coil.z_m": -0.042,
        },
    )
    posterior, coordinates = simulated.real, simulated.real.coordinates
    fit = levenberg_marquardt(posterior, coordinates.start()[None])

    def minus_log_posterior(shares: np.ndarray) -> float:
        values = lower + torch.from_numpy(shares) * (upper - lower)
        return -float(posterior(coordinates.vector(dict(zip(coordinates.names, values, strict=True)))))

    lower, upper = coordinates.bounds()
    is_noise = torch.tensor([name == "hall.noise_T" for name in coordinates.names])
    lower, upper = torch.where(is_noise, 1e-5, lower), torch.where(is_noise, 1e-2, upper)
    inside = [(1e-6, 1.0 - 1e-6)] * coordinates.n
    scipy_result = scipy.optimize.minimize(
        minus_log_posterior, np.full(coordinates.n, 0.5), method="L-BFGS-B", bounds=inside
    )
    scipy_result = scipy.optimize.minimize(
        minus_log_posterior, scipy_result.x, method="Nelder-Mead", bounds=inside, options={"maxiter": 4000}
    )
    assert fit.is_converged.all()
    assert fit.n_iterations < 60
    assert float(fit.log_posterior[0]) > -scipy_result.fun - 0.05
    values = coordinates.values(fit.vector[0])
    held = [
        name
        for name, p in simulated.rig.parameters.items()
        if p.prior and _at_end(float(values[name]), p.prior)
    ]
    assert len(held) > 1


def test_a_step_to_where_no_winding_exists_is_refused():
    """Noise-free readings from a start where the full step leads to an area without a radius (not a number), found by the solver study."""
    problem = SolverProblem()
    posterior = LogPosterior(problem.coordinates, problem.model, problem.readings)
    start = torch.tensor(
        [[0.05349318131435165, 0.0003214883031304358, 43.075244680546675, 12.05315999248238]],
        dtype=torch.float64,
    )
    fit = levenberg_marquardt(posterior, problem.vector(start), max_iterations=200)
    torch.testing.assert_close(
        problem.values(fit.vector)[0],
        torch.tensor(list(TRUTH.values()), dtype=torch.float64),
        rtol=1e-3,
        atol=0.0,
    )


def _at_end(value: float, prior: Prior) -> bool:
    return min(value - prior.lower, prior.upper - value) < 1e-3 * prior.sd


@pytest.mark.parametrize("prior", ["normal: {mean: 0, sd: 60}", "uniform: {lower: -180, upper: 180}"])
def test_what_the_readings_cannot_see_stays_put_and_keeps_the_width_of_its_prior(problem, prior):
    """Spin of a fixed coil about its axis; a flat prior has no curvature either, so the matrix would be singular."""
    posterior = problem(
        f"""{{coil1: {{radius_mm: {{prior: {{normal: {{mean: 50, sd: 1}}}}}}, wire_radius_mm: 1, axial_loops: 3, radial_loops: 2,
  world_from_coil: {{z_mm: -40, rx_deg: 10, spin_deg: {{prior: {{{prior}}}}}}}}}}}"""
    ).real
    start = posterior.coordinates.start()
    fit = levenberg_marquardt(posterior, start[None])
    assert fit.is_converged.all()
    column = posterior.coordinates.names.index("coil1.world_from_coil.spin_rad")
    assert fit.vector[0, column].item() == pytest.approx(0.0, abs=1e-3)
    sd = torch.linalg.inv(fit.precision[0])[column, column].sqrt() / posterior.coordinates.scale[column]
    assert 0.99 < sd.item() < 4.0


def test_a_start_that_cannot_win_any_more_ends_and_the_highest_maximum_stays(tmp_path):
    """One of four starts is caught 7000 below the others, and crawls on for as long as it may."""
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    (tmp_path / "plan.yaml").write_text(PLAN, encoding="utf-8")
    plan = load_plan(tmp_path / "plan.yaml", rig)
    observations = simulate(rig, plan, draw_truth(rig, 0), seed=0)
    coordinates = Coordinates(rig)
    posterior = LogPosterior(coordinates, MeasurementModel.build(rig, observations), observations)
    starts = torch.cat((coordinates.start()[None], coordinates.sample_prior(np.random.default_rng(3), 3)))
    everything = levenberg_marquardt(posterior, starts, tolerance=1e-4)
    race = levenberg_marquardt(posterior, starts, tolerance=1e-4, is_race=True)
    assert everything.log_posterior.max() - everything.log_posterior.min() > 1000.0
    assert float(race.log_posterior.max()) == pytest.approx(float(everything.log_posterior.max()), abs=1e-3)
    assert race.is_converged[race.log_posterior.argmax()]
    assert race.n_iterations < 0.5 * everything.n_iterations
    assert race.is_converged.sum() == 1  # starts that go to the same maximum leave it to one of them
