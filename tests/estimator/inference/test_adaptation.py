"""Adaptive importance sampling: a proposal that is fitted to a density with a bent or heavy tail covers it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.inference.adaptation import ENOUGH, adapted, efficiency_of
from estimator.inference.bend import Bend
from estimator.inference.lattice import CountMixture
from estimator.inference.proposal import MixtureProposal

pytestmark = pytest.mark.whole

N = 4
LAPLACE = CountMixture(
    torch.tensor([[7.0], [8.0]], dtype=torch.float64),
    torch.tensor([0.5, 0.5], dtype=torch.float64),
    torch.zeros(2, N, dtype=torch.float64),
    torch.eye(N, dtype=torch.float64).expand(2, N, N),
)
CURVATURE = 1.5


def log_banana(vectors: np.ndarray) -> np.ndarray:
    """A normal law whose last coordinate is bent along the first; 8 loops are four times as probable as 7."""
    straight = vectors[:, :N].copy()
    straight[:, -1] -= CURVATURE * straight[:, 0] ** 2
    return -0.5 * (straight**2).sum(1) + np.where(vectors[:, N] == 8.0, np.log(0.8), np.log(0.2))


def efficiency(proposal: MixtureProposal, log_prob=log_banana) -> float:
    """By draws of the proposal itself, which took no part in its fit."""
    draws = proposal.draw(20_000, np.random.RandomState(99))
    log_density = proposal.log_density(draws)
    return efficiency_of(log_density, log_prob(draws), log_density)


def test_bent_posterior_is_straightened():
    laplace = MixtureProposal(LAPLACE)
    fitted, told = adapted(laplace, log_banana, np.random.RandomState(0))
    assert told == pytest.approx(efficiency(fitted), abs=0.08)
    assert efficiency(laplace) < 0.2
    assert efficiency(fitted) > ENOUGH - 0.05
    assert fitted.bend.curvature[-1, 0, 0] == pytest.approx(CURVATURE, rel=0.1)
    assert fitted.weight[1] > fitted.weight[0]


def test_posterior_that_hardly_any_draw_hits_is_straightened_too():
    """Twenty coordinates, five of them bent by twice their widths: of a thousand draws one or two have all the weight."""
    n, bends = 20, [(19, 0, 1), (18, 2, 3), (17, 4, 5), (16, 6, 7), (15, 8, 9)]

    def log_bent(vectors: np.ndarray) -> np.ndarray:
        straight = vectors[:, :n].copy()
        for bent, j, k in bends:
            straight[:, bent] -= 2.0 * vectors[:, j] * vectors[:, k]
        return -0.5 * (straight**2).sum(1)

    alone = CountMixture(
        torch.tensor([[7.0]]).double(),
        torch.ones(1).double(),
        torch.zeros(1, n).double(),
        torch.eye(n)[None].double(),
    )
    laplace = MixtureProposal(alone)
    fitted, _ = adapted(laplace, log_bent, np.random.RandomState(0))
    assert efficiency(laplace, log_bent) < 0.01
    assert efficiency(fitted, log_bent) > 0.7


def test_proposal_is_never_worse_than_the_one_it_began_with():
    """A density that no component can follow: a thin ring."""

    def log_ring(vectors: np.ndarray) -> np.ndarray:
        return -200.0 * (np.linalg.norm(vectors[:, :N], axis=1) - 3.0) ** 2

    laplace = MixtureProposal(LAPLACE)
    fitted, _ = adapted(laplace, log_ring, np.random.RandomState(1))
    assert efficiency(fitted, log_ring) > 0.8 * efficiency(laplace, log_ring)


def chain_of_squares(n: int = 14, correlation: float = 0.0) -> MixtureProposal:
    """A proposal that leaves the range of numbers within its tails."""
    bend = Bend.none(n)
    for i in range(1, n):
        bend.curvature[i, i - 1, i - 1] = 1.0
    law = CountMixture(
        torch.zeros(1, 0).double(),
        torch.ones(1).double(),
        torch.zeros(1, n).double(),
        ((1.0 - correlation) * torch.eye(n) + correlation)[None].double(),
    )
    return MixtureProposal(law, bend)


def test_draws_that_a_bend_throws_to_infinity_do_not_count():
    begin = chain_of_squares()
    assert not np.isfinite(begin.draw(2000, np.random.RandomState(0))).all()

    def log_normal(vectors: np.ndarray) -> np.ndarray:
        is_near = (np.abs(vectors) < 10.0).all(1)
        return np.where(is_near, -0.5 * (np.where(is_near[:, None], vectors, 0.0) ** 2).sum(1), -np.inf)

    def share_that_counts(proposal: MixtureProposal) -> float:
        draws = proposal.draw(20_000, np.random.RandomState(2))
        draws = draws[np.isfinite(log_normal(draws))]
        log_density = proposal.log_density(draws)
        return efficiency_of(log_density, log_normal(draws), log_density)

    found, _ = adapted(begin, log_normal, np.random.RandomState(1))
    assert share_that_counts(found) > 0.01  # a chain of squares is no easy place to begin from


def test_draws_whose_own_density_is_rounded_away_do_not_count():
    """The target has a density wherever there are numbers, as where bounds of a prior hold coordinates back."""

    def log_bounded(vectors: np.ndarray) -> np.ndarray:
        there = np.isfinite(vectors).all(1)
        return np.where(there, -0.5 * (np.minimum(np.abs(vectors), 20.0) ** 2).sum(1), -np.inf)

    begin = chain_of_squares(11, correlation=0.5)
    draws = begin.draw(2000, np.random.RandomState(1))
    assert (np.isfinite(log_bounded(draws)) & ~np.isfinite(begin.log_density(draws))).any()
    _, told = adapted(begin, log_bounded, np.random.RandomState(1))
    assert 0.0 < told <= 1.0


def test_efficiency_is_that_of_the_textbook():
    """A normal law of half the spread of its proposal: 1 / integral p^2 / q = sqrt(7) / 4."""
    points, spacing = np.linspace(-30.0, 30.0, 200_001, retstep=True)
    log_proposal, log_target = -0.125 * points**2 - np.log(2.0), -0.5 * points**2
    log_uniform = np.full_like(points, -np.log(60.0 + spacing))
    assert efficiency_of(log_proposal - 0.5 * np.log(2.0 * np.pi), log_target, log_uniform) == pytest.approx(
        np.sqrt(7.0) / 4.0, rel=1e-3
    )
    assert ENOUGH < 1.0


def test_bend_is_the_least_squares_fit_of_every_coordinate_on_those_before():
    random = np.random.RandomState(4)
    points = random.standard_normal((300, 4))
    weight = random.uniform(1.0, 2.0, 300)
    weight /= weight.sum()
    bend = Bend.fitted(points, weight)
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    columns = np.stack((np.ones(300), x, y, z, x * x, y * x, y * y, z * x, z * y, z * z), axis=1)
    n_effective, prior_sd = 1.0 / (weight**2).sum(), 0.2
    rows = np.concatenate((columns * np.sqrt(n_effective * weight)[:, None], np.eye(10)[4:] / prior_sd))
    wanted = np.concatenate((points[:, 3] * np.sqrt(n_effective * weight), np.zeros(6)))
    expected = np.linalg.lstsq(rows, wanted)[0]
    found = [bend.offset[3], *bend.slope[3, :3], *bend.curvature[3][np.tril_indices(3)]]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    np.testing.assert_allclose(bend.bent(bend.straightened(points)), points, atol=1e-14)
