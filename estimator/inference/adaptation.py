"""A proposal fitted to the posterior before sampling: adaptive importance sampling in whitened coordinates.

The Laplace approximation knows the curvature at the maximum and nothing of a long or bent tail. Where its proposal is a thousand times too
thin, a walker that gets there cannot leave, and the effective sample size collapses. Weighted draws show such a tail. A bend is fitted to
them by least squares, and to what it straightens a few Student-t laws by expectation maximisation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import logsumexp

from estimator.inference.bend import Bend
from estimator.inference.proposal import DEGREES_OF_FREEDOM, MixtureProposal, WhiteShape

ROUNDS, DRAWS = 8, 2000
ENOUGH = 0.75  # efficiency at which a proposal is left as it is: to fit on costs more than it brings to 10,000 effective samples
WIDENED, WIDE_SHARE = 2.0, 0.3  # share of draws from a wider law, which sees tails that the proposal misses
COMPONENTS, ITERATIONS = 6, 20
DEFENSIVE = 0.1  # weight of the standard component that always stays, so that no place becomes unreachable
OLD_WEIGHT = 0.5  # share of the Laplace weights in those of the tuples of counts


def adapted(
    proposal: MixtureProposal,
    log_prob: Callable[[np.ndarray], np.ndarray],
    random: np.random.RandomState,
) -> tuple[MixtureProposal, float]:
    """The proposal, fitted to a density in at most `ROUNDS` rounds of `DRAWS` draws; the best of all rounds, and its efficiency.

    Each proposal is judged by fresh draws that took no part in its fit.

    Args:
        proposal: Where to begin.
        log_prob: Log density at vectors, shape (point, coordinate), up to a constant; -inf where it is zero.
        random: Draws, and places the first components.
    References: Cappé et al., Stat. Comput. 18, 447 (2008), adaptive importance sampling in mixture classes; Ionides, J. Comput. Graph.
        Stat. 17, 295 (2008), truncated weights.
    """
    best, best_efficiency = proposal, 0.0
    vectors, log_weight = np.empty((0, proposal.n + proposal.counts.shape[1])), np.empty(0)
    for _ in range(ROUNDS):
        fresh, log_drawn = _draws(proposal, random)
        log_target = log_prob(fresh)
        is_there = np.isfinite(log_target)
        if not is_there.any():
            break
        # Heavy tails and a bend throw some draws far out, even to infinity, where no density has a value; that of the target is zero there.
        log_target = np.where(is_there, log_target, -np.inf)
        log_drawn = np.where(is_there, log_drawn, 0.0)
        log_own = np.zeros(len(fresh))
        log_own[is_there] = proposal.log_density(fresh[is_there])
        efficiency = efficiency_of(log_own, log_target, log_drawn)
        if efficiency > best_efficiency:
            best, best_efficiency = proposal, efficiency
        if efficiency >= ENOUGH:
            break
        vectors = np.concatenate((vectors, fresh))
        log_weight = np.concatenate((log_weight, log_target - log_drawn))
        proposal = _fitted(proposal, vectors, _truncated(log_weight), random)
    return best, best_efficiency


def efficiency_of(log_proposal: np.ndarray, log_target: np.ndarray, log_drawn: np.ndarray) -> float:
    """Effective draws per draw of a proposal q as importance law of a target p: 1 / integral of p^2 / q, which is 1 where they agree.

    Args:
        log_proposal: Log density of q at points drawn from any law that covers p, shape (draw,).
        log_target: Log density of p there, up to a constant.
        log_drawn: Log density of the law that they were drawn from.
    Examples:
        >>> log_density = np.zeros(5)
        >>> efficiency_of(log_density, log_density, log_density)
        1.0
    """
    log_weight = log_target - log_drawn
    log_evidence = logsumexp(log_weight)
    log_integral = logsumexp(log_weight + log_target - log_proposal)
    return float(np.exp(2.0 * log_evidence - log_integral - np.log(len(log_weight))))


def _draws(proposal: MixtureProposal, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
    """Draws of the proposal and of a wider one, and the log density of both together there."""
    shape = proposal.shape
    wider = WhiteShape(shape.weight, shape.mean, WIDENED * shape.factor)
    wide = MixtureProposal(proposal.mixture, proposal.bend, wider, proposal.weight)
    n_wide = int(WIDE_SHARE * DRAWS)
    vectors = np.concatenate((proposal.draw(DRAWS - n_wide, random), wide.draw(n_wide, random)))
    with np.errstate(over="ignore", invalid="ignore"):  # far out; no such draw counts
        log_drawn = np.logaddexp(
            np.log1p(-WIDE_SHARE) + proposal.log_density(vectors),
            np.log(WIDE_SHARE) + wide.log_density(vectors),
        )
    return vectors, np.asarray(log_drawn)


def _truncated(log_weight: np.ndarray) -> np.ndarray:
    """Weights that add up to 1, none larger than the square root of their number times their mean."""
    weight = np.exp(log_weight - log_weight.max())
    weight = np.minimum(weight, weight.mean() * np.sqrt(len(weight)))
    return np.asarray(weight / weight.sum())


def _fitted(
    proposal: MixtureProposal, vectors: np.ndarray, weight: np.ndarray, random: np.random.RandomState
) -> MixtureProposal:
    counts = weight > 0.0
    vectors, weight = vectors[counts], weight[counts]
    row = proposal.rows(vectors)
    white = proposal.white(row, vectors)
    bend = Bend.fitted(white, weight)
    shape = fitted_shape(bend.straightened(white), weight, random)
    tuple_weight = np.bincount(row, weight, minlength=len(proposal.weight))
    laplace = MixtureProposal(proposal.mixture).weight
    return MixtureProposal(
        proposal.mixture, bend, shape, OLD_WEIGHT * laplace + (1.0 - OLD_WEIGHT) * tuple_weight
    )


def fitted_shape(white: np.ndarray, weight: np.ndarray, random: np.random.RandomState) -> WhiteShape:
    """Student-t laws fitted to weighted points, beside a standard one with weight `DEFENSIVE`.

    Scale matrices are drawn towards half the covariance of all points, by as much as n + 2 points would: few points in many dimensions
    leave a matrix that can be factorised.

    Args:
        white: Points, shape (point, n).
        weight: Their weights, which add up to 1.
        random: Places the first middles, far from each other.
    """
    n = white.shape[1]
    middle = weight @ white
    overall = (weight[:, None] * (white - middle)).T @ (white - middle) + 1e-9 * np.eye(n)
    n_effective, n_pseudo = 1.0 / float((weight**2).sum()), n + 2.0
    mean = _far_apart(white, weight, random)
    factor = np.repeat(np.linalg.cholesky(overall)[None], COMPONENTS, axis=0)
    share = np.full(COMPONENTS, 1.0 / COMPONENTS)
    for _ in range(ITERATIONS):
        shape = _beside_standard(share, mean, factor)
        log_densities = shape.log_densities(white)
        belongs = np.exp(log_densities - logsumexp(log_densities, axis=1, keepdims=True))[:, :-1]
        belongs *= weight[:, None]
        nearness = (DEGREES_OF_FREEDOM + n) / (DEGREES_OF_FREEDOM + shape.squared_distances(white)[:, :-1])
        pull = belongs * nearness
        total = belongs.sum(0)
        is_used = total > 1e-9
        mean[is_used] = (pull.T @ white)[is_used] / pull.sum(0)[is_used, None]
        centred = white - mean[:, None]
        scatter = (pull.T[:, :, None] * centred).swapaxes(1, 2) @ centred
        scale = (n_effective * scatter + n_pseudo * 0.5 * overall) / (n_effective * total + n_pseudo)[
            :, None, None
        ]
        factor = np.linalg.cholesky(scale)
        share = (total + 1e-3) / (total + 1e-3).sum()
    return _beside_standard(share, mean, factor)


def _far_apart(white: np.ndarray, weight: np.ndarray, random: np.random.RandomState) -> np.ndarray:
    """First middles: each drawn with a probability that grows with the squared distance from those before (k-means++)."""
    chosen = [white[random.choice(len(white), p=weight)]]
    for _ in range(COMPONENTS - 1):
        squared = np.min([((white - mean) ** 2).sum(1) for mean in chosen], axis=0) * weight
        chosen.append(
            white[random.choice(len(white), p=squared / squared.sum() if squared.sum() > 0 else weight)]
        )
    return np.array(chosen)


def _beside_standard(share: np.ndarray, mean: np.ndarray, factor: np.ndarray) -> WhiteShape:
    standard = WhiteShape.standard(mean.shape[1])
    return WhiteShape(
        np.append((1.0 - DEFENSIVE) * share, DEFENSIVE),
        np.concatenate((mean, standard.mean)),
        np.concatenate((factor, standard.factor)),
    )
