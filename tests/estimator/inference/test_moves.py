"""Moves: the density they claim is the one they draw from, and the chains they make have the right law."""

from __future__ import annotations

from collections.abc import Callable

import emcee
import numpy as np
import pytest
import torch
from emcee.backends import Backend
from scipy import stats

from estimator.inference.bend import Bend
from estimator.inference.convergence import convergence
from estimator.inference.lattice import CountMixture
from estimator.inference.moves import (
    BLOCK,
    LatticeDifferenceMove,
    MovesInBlocks,
    autoregressive_move,
)
from estimator.inference.proposal import DEGREES_OF_FREEDOM, FLOOR, MixtureProposal, WhiteShape

pytestmark = pytest.mark.whole

COUNTS = np.array([[5.0, 4.0], [6.0, 4.0], [8.0, 3.0]])
WEIGHT = np.array([0.2, 0.5, 0.3])
MEAN = np.array([[0.0, 1.0], [0.5, 0.8], [-1.0, 2.0]])
COVARIANCE = np.array([[[1.0, 0.3], [0.3, 0.5]], [[0.4, -0.2], [-0.2, 0.6]], [[2.0, 0.0], [0.0, 0.1]]])


def mixture(weight: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> CountMixture:
    return CountMixture(*map(torch.from_numpy, (COUNTS, weight, mean, covariance)))


RIGHT = mixture(WEIGHT, MEAN, COVARIANCE)
# Weights the wrong way round, centres off by a standard deviation, and twice, half or twice the spread without its correlation.
WRONG = mixture(
    WEIGHT[[2, 0, 1]],
    MEAN + np.array([[0.9, -0.6], [-0.6, 0.5], [1.0, 0.3]]),
    np.stack((2.0 * COVARIANCE[0], 0.5 * COVARIANCE[1], np.diag([3.0, 0.3]))),
)


BENT = MixtureProposal(
    RIGHT,
    Bend(
        np.array([[[0.0, 0.0], [0.0, 0.0]], [[0.2, 0.0], [0.0, 0.0]]]),
        np.tril(np.full((2, 2), 0.1), -1),
        np.array([0.1, -0.2]),
    ),
    WhiteShape(
        np.array([0.7, 0.3]),
        np.array([[0.0, 0.1], [0.5, -0.4]]),
        np.stack((np.eye(2), 1.5 * np.eye(2))),
        np.array([30.0, 8.0]),
    ),
)


@pytest.fixture(params=["right", "wrong", "bent"])
def proposal(request) -> MixtureProposal:
    return {"right": MixtureProposal(RIGHT), "wrong": MixtureProposal(WRONG), "bent": BENT}[request.param]


def target_log_prob(vectors: np.ndarray) -> np.ndarray:
    """The known target: a normal mixture over the three pairs of counts."""
    row = (vectors[:, None, 2:] == COUNTS).all(axis=-1).argmax(axis=1)
    centred = vectors[:, :2] - MEAN[row]
    chi2 = np.einsum("wi,wij,wj->w", centred, np.linalg.inv(COVARIANCE)[row], centred)
    return np.log(WEIGHT[row]) - 0.5 * chi2 - 0.5 * np.log(np.linalg.det(2.0 * np.pi * COVARIANCE))[row]


def target_draws(size: int, random: np.random.RandomState, row: np.ndarray | None = None) -> np.ndarray:
    row = random.choice(3, size, p=WEIGHT) if row is None else row
    continuous = [random.multivariate_normal(MEAN[i], COVARIANCE[i]) for i in row]
    return np.concatenate((continuous, COUNTS[row]), axis=1)


@pytest.mark.parametrize("claimed", [RIGHT, WRONG], ids=["right", "wrong"])
def test_density_is_the_mixture_of_students_t_that_its_arguments_say(claimed):
    proposal = MixtureProposal(claimed)
    vectors = target_draws(40, np.random.RandomState(0))
    weight = (1.0 - FLOOR) * claimed.weight.numpy() + FLOOR / 3.0
    rows = [COUNTS.tolist().index(counts) for counts in vectors[:, 2:].tolist()]
    expected = [
        np.log(weight[i])
        + stats.multivariate_t(
            claimed.mean[i].numpy(), claimed.covariance[i].numpy(), DEGREES_OF_FREEDOM
        ).logpdf(v[:2])
        for i, v in zip(rows, vectors, strict=True)
    ]
    np.testing.assert_allclose(proposal.log_density(vectors), expected, rtol=1e-10)


def test_draws_have_the_density(proposal):
    """Importance weights of draws average to one on every pair of counts and for every half-space."""
    draws = proposal.draw(40_000, np.random.RandomState(1))
    ratio = np.exp(target_log_prob(draws) - proposal.log_density(draws))
    for i, counts in enumerate(COUNTS):
        here = (draws[:, 2:] == counts).all(axis=1)
        low = here & (draws[:, 0] + draws[:, 1] < MEAN[i].sum())
        for chosen, expected in ((here, WEIGHT[i]), (low, 0.5 * WEIGHT[i])):
            sampled = np.where(chosen, ratio, 0.0)
            assert abs(sampled.mean() - expected) < 4.0 * sampled.std() / np.sqrt(len(draws))


def chain_in_blocks(proposal: MixtureProposal, steps: int, backend: Backend, calls: list[int]) -> np.ndarray:
    """A chain that may continue an earlier one, noting how many points each call of the density takes."""

    def counted(vectors: np.ndarray) -> np.ndarray:
        calls.append(len(vectors))
        return target_log_prob(vectors)

    done = backend.iteration if backend.initialized else 0
    sampler = emcee.EnsembleSampler(
        20, 4, counted, moves=MovesInBlocks(proposal, 3, done), vectorize=True, backend=backend
    )
    random = np.random.RandomState(4)
    start = emcee.State(target_draws(20, random), random_state=random.get_state())
    sampler.run_mcmc(backend.get_last_sample() if done else start, steps, skip_initial_state_check=True)
    return sampler.get_chain()


@pytest.mark.parametrize("interrupted_at", [5, BLOCK, 2 * BLOCK + 3])
def test_chain_continued_within_a_block_is_that_of_an_uninterrupted_run(proposal, interrupted_at):
    expected = chain_in_blocks(proposal, 3 * BLOCK, Backend(), [])
    backend = Backend()
    chain_in_blocks(proposal, interrupted_at, backend, [])
    np.testing.assert_array_equal(
        chain_in_blocks(proposal, 3 * BLOCK - interrupted_at, backend, []), expected
    )


def test_draws_without_a_density_are_not_accepted(monkeypatch):
    """The target has one there, so that the ratio would be infinite."""
    proposal = MixtureProposal(RIGHT)
    known = proposal.log_density
    monkeypatch.setattr(
        proposal, "log_density", lambda vectors: np.where(vectors[:, 1] > 2.5, -np.inf, known(vectors))
    )
    draws = target_draws(200, np.random.RandomState(9))
    start = draws[draws[:, 1] <= 2.5][:20]
    moves = MovesInBlocks(proposal, 3, shares=(1.0, 0.0, 0.0))
    sampler = emcee.EnsembleSampler(20, 4, target_log_prob, moves=moves, vectorize=True)
    sampler.run_mcmc(start, 2 * BLOCK, skip_initial_state_check=True)
    chain = sampler.get_chain()
    assert chain[..., 1].max() <= 2.5
    assert sampler.acceptance_fraction.mean() > 0.5


@pytest.mark.parametrize(
    "shares", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)], ids=["fresh", "part", "de"]
)
def test_proposals_that_overflow_are_refused_and_asked_no_density(shares):
    """A bend throws half of them to infinity, where a product with zero is no number; the other half stays in the law."""
    bend = Bend(
        np.array([[[0.0, 0.0], [0.0, 0.0]], [[5e307, 0.0], [0.0, 0.0]]]), np.zeros((2, 2)), np.zeros(2)
    )
    flat = WhiteShape(np.ones(1), np.array([[0.0, 0.0]]), 3.0 * np.eye(2)[None])
    proposal = MixtureProposal(RIGHT, bend, flat)
    drawn = proposal.draw(400, np.random.RandomState(2))
    assert 0.2 < np.isnan(drawn).any(1).mean() < 0.8
    asked: list[np.ndarray] = []

    def log_prob(vectors: np.ndarray) -> np.ndarray:
        asked.append(vectors)
        return np.where(np.abs(vectors[:, 1]) < 1e300, target_log_prob(np.clip(vectors, -1e9, 1e9)), -np.inf)

    start = target_draws(20, np.random.RandomState(9))
    sampler = emcee.EnsembleSampler(
        20, 4, log_prob, moves=MovesInBlocks(proposal, 3, shares=shares), vectorize=True
    )
    sampler.run_mcmc(start, 2 * BLOCK, skip_initial_state_check=True)
    assert np.isfinite(np.concatenate(asked)).all()
    assert np.abs(sampler.get_chain()[..., :2]).max() < 1e9
    assert np.isfinite(sampler.get_log_prob()).all()


def test_factor_of_the_autoregressive_move_is_the_ratio_of_normals_in_straightened_coordinates_and_counts_stay(
    proposal,
):
    old = target_draws(50, np.random.RandomState(4))
    new, factor = autoregressive_move(proposal).get_proposal(old, np.random.RandomState(5))
    np.testing.assert_array_equal(new[:, 2:], old[:, 2:])
    normal = stats.multivariate_normal(np.zeros(2))
    of_new, of_old = (normal.logpdf(proposal.straight(proposal.rows(old), vectors)) for vectors in (new, old))
    np.testing.assert_allclose(factor, of_old - of_new, rtol=1e-9, atol=1e-12)
    assert np.ptp(factor) > 0.5


def test_difference_move_is_symmetric_keeps_the_counts_and_moves_every_walker():
    move, random = LatticeDifferenceMove(MixtureProposal(RIGHT)), np.random.RandomState(6)
    moved, others = target_draws(400, random), target_draws(400, random)
    new, factor = move.get_proposal(moved, [others[:150], others[150:]], random)
    np.testing.assert_array_equal(factor, 0.0)
    np.testing.assert_array_equal(new[:, 2:], moved[:, 2:])
    step = new[:, :2] - moved[:, :2]
    assert (np.abs(step).sum(axis=1) > 0.0).all()
    white = np.linalg.solve(
        MixtureProposal(RIGHT).factor[MixtureProposal(RIGHT).rows(moved)], step[..., None]
    )[..., 0]
    assert np.abs(white.mean(axis=0)).max() < 0.15
    assert 0.5 < white.std() < 2.5


MovesOf = Callable[[MixtureProposal], list[tuple[emcee.moves.Move, float]]]
MOVES: dict[str, MovesOf] = {
    "independence": lambda proposal: [(MovesInBlocks(proposal, 3, shares=(1.0, 0.0, 0.0)), 1.0)],
    # Around a centre that is off and too narrow, the autoregressive move alone is slow to come back from the tails.
    "autoregressive": lambda proposal: [
        (autoregressive_move(proposal), 0.6),
        (LatticeDifferenceMove(proposal), 0.4),
    ],
    "difference": lambda proposal: [(LatticeDifferenceMove(proposal), 1.0)],
    "blocks": lambda proposal: [(MovesInBlocks(proposal, 3), 1.0)],
}


def chain_of(moves: MovesOf, proposal: MixtureProposal, steps: int, seed: int) -> np.ndarray:
    """Step by walker by coordinate, from a start that is already distributed as the target; 20 walkers."""
    random = np.random.RandomState(seed)
    row = np.repeat(
        [0, 1, 2], [4, 10, 6]
    )  # the difference move cannot change how many walkers have which counts
    sampler = emcee.EnsembleSampler(20, 4, target_log_prob, moves=moves(proposal), vectorize=True)
    start = emcee.State(target_draws(20, random, row), random_state=random.get_state())
    sampler.run_mcmc(start, steps, skip_initial_state_check=True)
    return sampler.get_chain()


def moments(chain: np.ndarray, row: int) -> np.ndarray:
    """First and second moments of a chain about the centre of one pair of counts, along a last axis."""
    x, y = np.moveaxis(chain[:, :, :2] - MEAN[row], -1, 0)
    return np.stack((x, y, x * x, x * y, y * y), axis=-1)


def assert_mean(sampled: np.ndarray, expected: np.ndarray) -> None:
    """Within four standard errors, and from a sample large enough to tell."""
    ess = convergence(sampled).ess_bulk
    error = np.abs(sampled.mean(axis=(0, 1)) - expected)
    assert (error < 4.0 * sampled.std(axis=(0, 1)) / np.sqrt(ess)).all()
    assert (ess > 300.0).all()


def exact_moments(row: int) -> np.ndarray:
    return np.array([0.0, 0.0, *COVARIANCE[row][[0, 0, 1], [0, 1, 1]]])


@pytest.mark.parametrize("moves", ["independence", "blocks"])
def test_chain_has_the_law_of_the_target_whatever_the_proposal(proposal, moves):
    """Probabilities of the counts, and moments of the coordinates at each of them."""
    chain = chain_of(MOVES[moves], proposal, steps=1500, seed=8)
    for row, counts in enumerate(COUNTS):
        here = (chain[:, :, 2:] == counts).all(axis=-1)[..., None].astype(float)
        assert_mean(here, WEIGHT[row])
        assert_mean(here * moments(chain, row), WEIGHT[row] * exact_moments(row))


@pytest.mark.parametrize("moves", ["autoregressive", "difference"])
def test_moves_within_the_counts_have_the_law_of_the_target_whatever_the_proposal(proposal, moves):
    chain = chain_of(MOVES[moves], proposal, steps=1500, seed=8)
    for row, counts in enumerate(COUNTS):
        here = (chain[:, :, 2:] == counts).all(axis=-1)
        assert (here == here[0]).all()
        assert_mean(moments(chain[:, here[0]], row), exact_moments(row))


def test_good_proposal_is_accepted_more_often_than_a_bad_one():
    moved = {}
    for name, of in (("right", RIGHT), ("wrong", WRONG)):
        chain = chain_of(MOVES["independence"], MixtureProposal(of), steps=300, seed=9)
        moved[name] = (np.diff(chain[..., 0], axis=0) != 0.0).mean()
    assert moved["right"] > 0.85
    assert moved["wrong"] < 0.6


def test_no_pair_of_counts_starves_in_the_proposal():
    draws = MixtureProposal(mixture(np.array([1.0, 0.0, 0.0]), MEAN, COVARIANCE)).draw(
        20_000, np.random.RandomState(2)
    )
    for counts in COUNTS[1:]:
        share = (draws[:, 2:] == counts).all(axis=1).mean()
        assert share == pytest.approx(FLOOR / 3.0, rel=0.2)
