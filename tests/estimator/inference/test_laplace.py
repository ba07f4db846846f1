"""Laplace's approximation: exact where the posterior is normal, and in plain words where the data are silent."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import stats

from estimator.inference.laplace import log_evidence, open_directions
from estimator.inference.levenberg_marquardt import Optimum, levenberg_marquardt
from estimator.inference.positive_definite import inverse
from estimator.rig.coordinates import Coordinates

pytestmark = pytest.mark.whole


def at_start(coordinates: Coordinates, information: torch.Tensor) -> Optimum:
    """A fit with a given information of the data."""
    start = coordinates.start()[None]
    return Optimum(
        start, torch.zeros(1).double(), information[None], information[None], torch.ones(1, dtype=bool), 1
    )


def test_covariance_is_the_inverse_whatever_the_units():
    random = np.random.default_rng(0)
    root = random.normal(size=(4, 6, 6))
    precision = root @ root.transpose(0, 2, 1) + 0.1 * np.eye(6)
    expected = np.linalg.inv(precision)
    for exponents in (np.zeros(6), np.array([0.0, 3.0, -3.0, 8.0, -8.0, 1.0])):
        unit = 10.0**exponents
        ours = inverse(torch.from_numpy(precision / np.outer(unit, unit))).numpy()
        np.testing.assert_allclose(ours / np.outer(unit, unit), expected, rtol=1e-9, atol=1e-11)
        np.testing.assert_array_equal(ours, ours.transpose(0, 2, 1))


def test_evidence_of_a_linear_problem_is_the_density_of_its_readings(linear_problem):
    """Readings are normal then: y ~ N(X m, s^2 1 + X S X^T). The prior's norm is left out of `log_evidence` as a constant."""
    posterior = linear_problem.real
    evidence = log_evidence(levenberg_marquardt(posterior, posterior.coordinates.start()[None]))
    design = torch.stack([posterior.predicted(row) for row in torch.eye(2).double()], -1).numpy()
    spread = 0.2e-6**2 * np.eye(len(design)) + design @ (0.05**2 * np.eye(2)) @ design.T
    unit_T = 1e-6  # SciPy takes eigenvalues of the covariance for zero that are small in absolute terms
    density = stats.multivariate_normal.logpdf(
        posterior.measured_T.numpy() / unit_T, design @ np.ones(2) / unit_T, spread / unit_T**2
    )
    expected = density - len(design) * math.log(unit_T) + 2.0 * math.log(0.05 * math.sqrt(2.0 * math.pi))
    assert evidence.item() == pytest.approx(expected, abs=1e-6)


def test_spin_of_a_fixed_coil_is_named_as_open(problem):
    posterior = problem(
        """{coil1: {radius_mm: {prior: {normal: {mean: 50, sd: 1}}}, wire_radius_mm: 1, axial_loops: 3, radial_loops: 2,
  world_from_coil: {z_mm: -40, rx_deg: 10, spin_deg: {prior: {normal: {mean: 0, sd: 5}}}}}}""",
        "{hall: {noise_uT: 0.1, carried_by: stage}}",
    ).real
    (direction,) = open_directions(
        posterior.coordinates, levenberg_marquardt(posterior, posterior.coordinates.start()[None])
    )
    assert direction.words == "coil1.world_from_coil.spin_rad"
    assert direction.shares == {"coil1.world_from_coil.spin_rad": 1.0}
    assert direction.data_over_prior_sd > 1e3


def test_turns_and_current_gain_are_named_as_exchangeable(problem):
    """The field fixes only the product of turns and current, where the winding is too fine to show single turns."""
    posterior = problem(
        """{coil1: {radius_mm: {prior: {normal: {mean: 50, sd: 1}}}, wire_radius_mm: {prior: {normal: {mean: 0.5, sd: 0.03}}},
  axial_loops: {prior: {normal: {mean: 18, sd: 1.8, lower: 1}}}, radial_loops: {prior: {normal: {mean: 12, sd: 1.2, lower: 1}}},
  current_gain: {prior: {normal: {mean: 1, sd: 0.1}}}, world_from_coil: {z_mm: {prior: {normal: {mean: -35, sd: 3}}}}}}""",
        "{hall: {noise_uT: 0.003, carried_by: stage}}",
        noise_T=0.0,
    ).real
    directions = open_directions(
        posterior.coordinates, levenberg_marquardt(posterior, posterior.coordinates.start()[None])
    )
    (direction,) = directions
    assert set(direction.shares) == {"coil1 turns", "coil1.current_gain"}
    assert direction.shares["coil1 turns"] * direction.shares["coil1.current_gain"] < 0.0
    first, second = direction.shares
    assert direction.words == f"{first} up together with {second} down"
    assert direction.data_over_prior_sd > 100.0


def test_open_directions_come_least_determined_first_and_stop_where_the_data_take_over(linear_problem):
    """Information of 1e-4, 0.25 and 4 per squared prior width: standard deviations 100, 2 and 0.5 of the prior's."""
    coordinates = linear_problem.real.coordinates
    sd = 0.05
    for first, second, expected in ((1e-4, 0.25, [100.0, 2.0]), (4.0, 0.25, [2.0]), (4.0, 9.0, [])):
        information = torch.diag(torch.tensor([first, second], dtype=torch.float64)) / sd**2
        directions = open_directions(coordinates, at_start(coordinates, information))
        assert [direction.data_over_prior_sd for direction in directions] == pytest.approx(expected, rel=1e-9)
    (named,) = open_directions(
        coordinates, at_start(coordinates, torch.diag(torch.tensor([4.0, 0.25]).double()) / sd**2)
    )
    assert named.words == "coil2.current_gain"
