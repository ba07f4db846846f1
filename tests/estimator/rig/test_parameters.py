"""Priors: their densities against SciPy's, draws against their densities, and impossible ones refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import stats

from estimator.errors import InvalidInput
from estimator.rig.parameters import LogNormal, Normal, Parameter, Tie, Uniform


def truncated_normal(mean: float, sd: float, lower: float, upper: float) -> stats.rv_continuous:
    return stats.truncnorm((lower - mean) / sd, (upper - mean) / sd, mean, sd)


class TruncatedLogNormal:
    """SciPy's log-normal between two bounds."""

    def __init__(self, median: float, sigma: float, lower: float, upper: float) -> None:
        self.whole, self.lower = stats.lognorm(sigma, scale=median), lower
        self.below = self.whole.cdf(lower)
        self.mass = self.whole.cdf(upper) - self.below

    def logpdf(self, x: np.ndarray) -> np.ndarray:
        return self.whole.logpdf(x) - math.log(self.mass)

    def cdf(self, x: np.ndarray) -> np.ndarray:
        return (self.whole.cdf(x) - self.below) / self.mass


CASES = {
    "normal": (Normal(48.0, 2.0), stats.norm(48.0, 2.0)),
    "normal, cut": (Normal(1.0, 2.0, 0.5, 2.5), truncated_normal(1.0, 2.0, 0.5, 2.5)),
    "log-normal": (LogNormal(20e-6, 0.5), stats.lognorm(0.5, scale=20e-6)),
    "log-normal, cut": (LogNormal(3.0, 0.4, 2.0, 3.5), TruncatedLogNormal(3.0, 0.4, 2.0, 3.5)),
    "uniform": (Uniform(-2.0, 3.0), stats.uniform(-2.0, 5.0)),
}
BY_NAME = pytest.mark.parametrize(("prior", "reference"), CASES.values(), ids=CASES)


@BY_NAME
def test_log_density_is_scipys_up_to_a_constant(prior, reference):
    draws = prior.sample(np.random.default_rng(0), 200)
    ours = prior.log_density(torch.from_numpy(draws)).numpy()
    difference = ours - reference.logpdf(draws)
    np.testing.assert_allclose(difference, difference[0], atol=1e-9)


@BY_NAME
def test_draws_follow_the_density(prior, reference):
    draws = prior.sample(np.random.default_rng(1), 4000)
    assert stats.kstest(draws, reference.cdf).pvalue > 0.01


@BY_NAME
def test_draws_depend_on_nothing_but_the_generator(prior, reference):
    first, second = (prior.sample(np.random.default_rng(2), 9) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert np.isfinite(reference.logpdf(first)).all()


@pytest.mark.parametrize(
    ("prior", "below", "above"),
    [
        (Normal(1.0, 2.0, 0.5, 2.5), 0.49, 2.51),
        (LogNormal(3.0, 0.4, 2.0, 3.5), 1.99, 3.51),
        (Uniform(-2.0, 3.0), -2.01, 3.01),
    ],
)
def test_density_is_zero_outside_the_bounds_only(prior, below, above):
    density = prior.log_density(torch.tensor([below, prior.lower, prior.upper, above], dtype=torch.float64))
    assert density.isneginf().tolist() == [True, False, False, True]


def test_log_normal_has_no_density_below_zero_and_no_nan_there():
    density = LogNormal(3.0, 0.4).log_density(torch.tensor([-1.0, -1e-9, 1e-9], dtype=torch.float64))
    assert density.isneginf().tolist() == [True, True, False]


@pytest.mark.parametrize(
    "prior", [Normal(1.0, 2.0), Normal(1.0, 2.0, 0.5, 2.5), LogNormal(3.0, 0.4), Uniform(-2.0, 3.0)]
)
def test_gradient_of_the_density_is_finite_inside_and_the_right_one(prior):
    value = torch.tensor([1.1, 2.2], dtype=torch.float64)
    gradient = torch.func.grad(lambda at: prior.log_density(at).sum())(value)
    step = 1e-5
    difference = (prior.log_density(value + step) - prior.log_density(value - step)) / (2.0 * step)
    torch.testing.assert_close(gradient, difference, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(
    ("prior", "centre"),
    [
        (Normal(1.0, 2.0), 1.0),
        (Normal(0.0, 2.0, lower=0.5), 0.5),
        (Normal(9.0, 2.0, upper=2.5), 2.5),
        (LogNormal(3.0, 0.4), 3.0),
        (LogNormal(3.0, 0.4, lower=4.0), 4.0),
        (Uniform(-2.0, 3.0), 0.5),
    ],
)
def test_centre_is_typical_and_always_allowed(prior, centre):
    assert prior.centre == centre
    assert torch.isfinite(prior.log_density(torch.tensor(prior.centre, dtype=torch.float64)))


def test_width_is_the_standard_deviation():
    assert Normal(1.0, 2.0).sd == 2.0
    assert Uniform(-2.0, 3.0).sd == pytest.approx(stats.uniform(-2.0, 5.0).std(), rel=1e-12)
    assert LogNormal(3.0, 0.01).sd == pytest.approx(stats.lognorm(0.01, scale=3.0).std(), rel=1e-3)


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (lambda: Normal(0.0, 0.0), "normal.sd must be > 0; received 0.0"),
        (lambda: Normal(0.0, -1.0), "normal.sd must be > 0"),
        (lambda: Normal(0.0, math.nan), "normal.sd must be > 0"),
        (lambda: Normal(0.0, 1.0, 2.0, 2.0), "normal.lower must be below upper"),
        (lambda: LogNormal(0.0, 1.0), "log_normal.median must be > 0"),
        (lambda: LogNormal(1.0, 0.0), "log_normal.relative_sd must be > 0"),
        (lambda: LogNormal(1.0, 1.0, lower=-0.1), "log_normal.lower must be"),
        (lambda: LogNormal(1.0, 1.0, 3.0, 2.0), "log_normal.lower must be"),
        (lambda: Uniform(1.0, 1.0), "uniform.lower must be below upper; received"),
    ],
)
def test_impossible_priors_are_refused_by_name(make, rule):
    with pytest.raises(InvalidInput) as caught:
        make()
    assert rule in str(caught.value)


def test_parameter_is_free_exactly_where_it_has_a_prior():
    assert Parameter("a", "m", 1.0, prior=Normal(1.0, 1.0)).is_free
    assert not Parameter("a", "m", 1.0).is_free
    assert not Parameter("a", "m", 1.0, tie=Tie("b", 2.0)).is_free


@pytest.mark.parametrize(
    "prior", [Normal(0.0, 2.0), Normal(0.0, 2.0, lower=0.0), Normal(1.0, 2.0, lower=0.0, upper=2.5)]
)
def test_density_of_a_normal_prior_integrates_to_one_however_it_is_truncated(prior):
    value = torch.linspace(-30.0, 30.0, 600_001, dtype=torch.float64)
    density = torch.exp(prior.log_density(value) + prior.log_normaliser)
    assert float(torch.trapezoid(density, value)) == pytest.approx(1.0, abs=1e-4)
