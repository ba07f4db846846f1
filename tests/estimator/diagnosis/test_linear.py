"""Evidence in the linear model against brute integration, and projection against least squares."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy import integrate, stats

from estimator.diagnosis.linear import (
    FreeNoise,
    Projector,
)
from estimator.diagnosis.linear import log_bayes_factor as log_bayes_factor_by_width


def problem(seed: int, n: int = 40) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Whitened Jacobian, its prior precision, new columns, and a residual."""
    random = torch.Generator().manual_seed(seed)
    jacobian, columns = (torch.randn(n, k, generator=random, dtype=torch.float64) for k in (3, 2))
    residual = torch.randn(n, generator=random, dtype=torch.float64)
    return jacobian, torch.diag(torch.tensor([0.5, 2.0, 1.0], dtype=torch.float64)), columns, residual


def log_bayes_factor(gram, score, prior_sd, noise=None) -> torch.Tensor:
    """Evidence of columns whose coefficients have standard deviations of their own."""
    scaled = gram * prior_sd[:, None] * prior_sd
    return log_bayes_factor_by_width(scaled, score * prior_sd, torch.ones(1).double(), noise)[0]


def test_evidence_of_one_column_is_the_integral_over_its_coefficient():
    random = np.random.default_rng(1)
    column, residual, prior_sd = random.normal(size=30), random.normal(size=30), 0.7

    def density(coefficient: float) -> float:
        likelihood = (
            stats.norm.logpdf(residual - coefficient * column).sum() - stats.norm.logpdf(residual).sum()
        )
        return math.exp(likelihood + stats.norm.logpdf(coefficient, scale=prior_sd))

    expected = math.log(integrate.quad(density, -5.0, 5.0)[0])
    t, r = torch.from_numpy(column), torch.from_numpy(residual)
    value = log_bayes_factor((t @ t)[None, None], (t @ r)[None], torch.tensor([prior_sd]).double())
    assert value.item() == pytest.approx(expected, abs=1e-6)


def test_evidence_beside_fitted_parameters_is_that_of_the_marginal_normal():
    """Both models as one normal distribution of the data, parameters integrated out."""
    jacobian, prior, columns, data = problem(2)
    sd = torch.tensor([0.5, 1.5], dtype=torch.float64)
    cov = torch.eye(len(data)).double() + jacobian @ torch.linalg.inv(prior) @ jacobian.T
    wider = cov + columns @ torch.diag(sd**2) @ columns.T
    expected = stats.multivariate_normal(cov=wider.numpy()).logpdf(data) - stats.multivariate_normal(
        cov=cov.numpy()
    ).logpdf(data)
    projector = Projector.of(jacobian, prior)
    residual = data - jacobian @ torch.linalg.solve(jacobian.T @ jacobian + prior, jacobian.T @ data)
    value = log_bayes_factor(projector.gram(columns, columns), columns.T @ residual, sd)
    assert value.item() == pytest.approx(float(expected), abs=1e-9)


def test_projection_takes_out_what_parameters_without_prior_can_follow():
    jacobian, _, columns, _ = problem(3)
    projector = Projector.of(jacobian, torch.zeros(3, 3, dtype=torch.float64))
    assert projector.gram(jacobian, jacobian).abs().max() < 1e-9
    left = columns - jacobian @ torch.linalg.lstsq(jacobian, columns).solution
    torch.testing.assert_close(projector.gram(columns, columns), left.T @ left)


def test_the_rest_of_a_vector_is_what_ridge_regression_leaves_of_it():
    jacobian, prior, _, vector = problem(5)
    augmented = torch.cat((jacobian, prior.sqrt()))
    best = torch.linalg.lstsq(augmented, torch.cat((vector, torch.zeros(3).double()))[:, None]).solution
    rest = Projector.of(jacobian, prior).rest(vector)
    torch.testing.assert_close(rest, vector - (jacobian @ best)[:, 0], rtol=1e-10, atol=1e-12)
    assert rest.norm() < 0.99 * vector.norm()


@pytest.mark.parametrize("amplitude", [0.3, 3.0, 30.0])
def test_noise_follows_as_far_as_its_prior_allows(amplitude):
    """Against the marginal normal density of the residuals at every noise; as many columns as data would explain them without bound."""
    random = torch.Generator().manual_seed(5)
    n, width = 20, 0.5
    columns = torch.randn(n, n, generator=random, dtype=torch.float64)
    residual = (
        torch.nn.functional.normalize(torch.randn(n, generator=random, dtype=torch.float64), dim=0) * n**0.5
    )

    def density(shrink: float) -> float:
        cov = math.exp(2.0 * shrink) * torch.eye(n).double() + amplitude**2 * columns @ columns.T
        return (
            float(stats.multivariate_normal(cov=cov.numpy()).logpdf(residual)) - 0.5 * (shrink / width) ** 2
        )

    alone = stats.norm.logpdf(residual.numpy()).sum()
    expected = max(density(shrink) for shrink in np.linspace(-5.0, 0.0, 101)) - alone
    sd = torch.full((n,), amplitude, dtype=torch.float64)
    value = log_bayes_factor(columns.T @ columns, columns.T @ residual, sd, FreeNoise(float(n), width))
    assert value.item() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("follows", [1e-13, 1e-12, 1e-11])
def test_rounding_of_a_column_that_the_fit_follows_takes_nothing_from_real_ones(follows):
    """Columns are rotated among each other, so that all carry rounding errors; the noise may shrink by a factor of a hundred."""
    random = torch.Generator().manual_seed(6)
    n = 200
    columns = torch.randn(n, 3, generator=random, dtype=torch.float64)
    residual = columns @ torch.tensor([30.0, 20.0, 10.0]).double() + torch.randn(n, generator=random).double()
    residual *= (n / residual.square().sum()).sqrt()
    gram = torch.block_diag(columns.T @ columns, torch.tensor([[follows]]).double())
    score = torch.cat((columns.T @ residual, torch.tensor([1e-5]).double()))
    turn = torch.linalg.qr(torch.randn(4, 4, generator=random, dtype=torch.float64)).Q
    noise = FreeNoise(float(n), 5.0)
    sd = torch.ones(4).double()
    clean = log_bayes_factor(gram[:3, :3], score[:3], sd[:3], noise)
    value = log_bayes_factor(turn.T @ gram @ turn, turn.T @ score, sd, noise)
    assert clean > 300.0
    assert value.item() == pytest.approx(clean.item(), abs=1.0)


def test_column_that_relieves_a_tense_parameter_does_not_shrink_the_noise_as_if_it_explained_residuals():
    """A parameter held 20 sd off its prior, and a column with the same effect: 200 in log evidence, whatever the noise does."""
    n, offset, tight_sd, wide_sd = 400, 20.0, 0.05, 1.0
    generator = torch.Generator().manual_seed(6)
    jacobian = 100.0 * torch.randn(n, 1, dtype=torch.float64, generator=generator)
    noise = torch.randn(n, dtype=torch.float64, generator=generator)
    noise = noise - jacobian[:, 0] * (jacobian[:, 0] @ noise) / jacobian.square().sum()
    noise = noise * math.sqrt(n) / noise.norm()
    precision = torch.tensor([[tight_sd**-2]], dtype=torch.float64)
    # The fit stands where the pull of the prior and that of the readings cancel.
    residual = noise + jacobian[:, 0] * offset / tight_sd / jacobian.square().sum()
    gram = Projector.of(jacobian, precision).gram(jacobian, jacobian)
    score, sd = jacobian.T @ residual, torch.tensor([wide_sd], dtype=torch.float64)
    relieved = float(log_bayes_factor(gram, score, sd))
    assert relieved == pytest.approx(0.5 * offset**2, rel=0.05)
    tense = float(log_bayes_factor(gram, score, sd, FreeNoise(float(n), 0.5, tension=offset**2)))
    assert relieved < tense < 1.5 * relieved
    assert float(log_bayes_factor(gram, score, sd, FreeNoise(float(n), 0.5))) > 3.0 * relieved
