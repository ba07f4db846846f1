"""A proposal fitted to the posterior before sampling: adaptive importance sampling in whitened coordinates.

The Laplace approximation knows the curvature at the maximum and nothing of a long or bent tail. Where its density is a thousand times too
small, a walker that gets there cannot leave, and the effective sample size collapses. Weighted draws show such a tail. First a map is
fitted to their log densities (`Straightening`), which is enough for a smooth posterior. Where that brings no gain, as at the bound of a
prior, a bend is fitted to the points themselves, and to the straightened points a few Student-t distributions by expectation maximisation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import logsumexp

from estimator.inference.bend import Bend
from estimator.inference.proposal import DEGREES_OF_FREEDOM, MixtureProposal, WhiteShape
from estimator.inference.straightening import Straightening, most_coefficients

ROUNDS = 9
# Draws of a round: two for each coefficient that a map may have, between these numbers; twenty coordinates need 3120.
FEWEST_DRAWS, DRAWS_PER_COEFFICIENT, MOST_DRAWS = 1000, 2, 3200
# Efficiency at which a proposal is good enough: at once, and once straightening brings no gain. More fitting costs more than it brings.
ENOUGH, FAIR = 0.9, 0.75
WORTH = 1.1  # a round of straightening gains where it multiplies the efficiency by as much
PATIENCE = 2  # rounds of straightening without a gain: while few draws have weight, the efficiency of one round says little
LATE_ROUNDS = 2  # whose draws are straightened; those of earlier rounds lie farther off
MOST_POINTS_LOST = 5.0  # points for each effective one, of those that tell of a bend
WIDENED, WIDE_SHARE = (
    2.0,
    0.3,
)  # share of draws from a wider distribution, which reaches tails that the proposal misses
LARGEST = 1e30  # coordinate of a draw that counts: squares of squares must stay numbers
COMPONENTS, ITERATIONS = 6, 20
DEFENSIVE = 0.1  # weight of the standard component that always stays, so that every point can be reached
STRAIGHT_FREEDOM = 50.0  # of what is straightened: nearly normal, with heavier tails than the posterior's
OLD_WEIGHT = 0.5  # share of the Laplace weights in those of the tuples of counts


def adapted(
    proposal: MixtureProposal, log_prob: Callable[[np.ndarray], np.ndarray], random: np.random.RandomState
) -> tuple[MixtureProposal, float]:
    """Fit the proposal to a density in at most `ROUNDS` rounds of draws; the best proposal of all rounds, and its efficiency.

    Each proposal is judged by new draws that took no part in its fit.

    Args:
        proposal: Where to begin.
        log_prob: Log density at vectors, shape (point, coordinate), up to a constant; -inf where it is zero.
        random: Draws, and places the first components.
    References: Cappé et al., Stat. Comput. 18, 447 (2008), adaptive importance sampling in mixture classes; Ionides, J. Comput. Graph.
        Stat. 17, 295 (2008), truncated weights.
    """
    best, best_efficiency = proposal, 0.0
    size = int(np.clip(DRAWS_PER_COEFFICIENT * most_coefficients(proposal.n), FEWEST_DRAWS, MOST_DRAWS))
    vectors, log_targets, log_weight = np.empty((0, proposal.n + proposal.counts.shape[1])), *np.empty((2, 0))
    n_without_gain, straightening = 0, None
    for _ in range(ROUNDS):
        fresh, log_drawn = _draws(proposal, size, random)
        log_target = log_prob(fresh)
        # Heavy tails and a bend throw some draws far out, even to infinity. Without a value, the target's density counts as zero.
        is_there = np.isfinite(log_target) & np.isfinite(log_drawn) & (np.abs(fresh) < LARGEST).all(1)
        if not is_there.any():
            break
        log_target = np.where(is_there, log_target, -np.inf)
        log_drawn = np.where(is_there, log_drawn, 0.0)
        log_own = np.zeros(len(fresh))
        log_own[is_there] = proposal.log_density(fresh[is_there])
        efficiency = efficiency_of(log_own, log_target, log_drawn)
        if n_without_gain < PATIENCE:
            n_without_gain = 0 if efficiency > WORTH * best_efficiency else n_without_gain + 1
        if efficiency > best_efficiency:
            best, best_efficiency = proposal, efficiency
        if best_efficiency >= (FAIR if n_without_gain else ENOUGH):
            break
        vectors = np.concatenate((vectors, fresh))
        log_targets = np.concatenate((log_targets, log_target))
        log_weight = np.concatenate((log_weight, log_target - log_drawn))
        if n_without_gain < PATIENCE:
            late = slice(-LATE_ROUNDS * size, None)
            fresh, weight = vectors[late], _tempered(log_weight[late])
            straightening = _straightening(proposal, fresh, log_targets[late], weight, straightening)
            proposal = _straightened(proposal, straightening, fresh, weight)
        else:
            proposal = _clustered(proposal, vectors, _truncated(log_weight), random)
    return best, best_efficiency


def efficiency_of(log_proposal: np.ndarray, log_target: np.ndarray, log_drawn: np.ndarray) -> float:
    """Effective draws per draw of a proposal q in importance sampling of a target p: 1 / integral of p^2 / q, which is 1 where they agree.

    Args:
        log_proposal: Log density of q at points drawn from any distribution that covers p, shape (draw,).
        log_target: Log density of p there, up to a constant.
        log_drawn: Log density of the distribution that they were drawn from.
    Examples:
        >>> log_density = np.zeros(5)
        >>> efficiency_of(log_density, log_density, log_density)
        1.0
    """
    log_weight = log_target - log_drawn
    log_evidence = logsumexp(log_weight)
    log_integral = logsumexp(log_weight + log_target - log_proposal)
    return float(np.exp(2.0 * log_evidence - log_integral - np.log(len(log_weight))))


def _draws(
    proposal: MixtureProposal, size: int, random: np.random.RandomState
) -> tuple[np.ndarray, np.ndarray]:
    """Draws of the proposal and of a wider one, and the log density of both together there."""
    shape = proposal.shape
    wider = WhiteShape(shape.weight, shape.mean, WIDENED * shape.factor, shape.freedom)
    wide = MixtureProposal(proposal.mixture, proposal.bend, wider, proposal.weight)
    n_wide = int(WIDE_SHARE * size)
    vectors = np.concatenate((proposal.draw(size - n_wide, random), wide.draw(n_wide, random)))
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


def _tempered(log_weight: np.ndarray) -> np.ndarray:
    """Truncated weights, raised to a power below 1 where few points have them all: log densities show a bend wherever the points lie."""
    weight = _truncated(log_weight)
    n_possible = int(np.isfinite(log_weight).sum())
    while float((weight**2).sum()) * n_possible > MOST_POINTS_LOST:
        log_weight = 0.5 * log_weight
        weight = _truncated(log_weight)
    return weight


def _straightening(
    proposal: MixtureProposal,
    vectors: np.ndarray,
    log_target: np.ndarray,
    weight: np.ndarray,
    begin: Straightening | None,
) -> Straightening:
    counts = weight > 0.0
    row = proposal.rows(vectors[counts])
    white = proposal.white(row, vectors[counts])
    return Straightening.fitted(white, log_target[counts], weight[counts], row, begin)


def _straightened(
    proposal: MixtureProposal, straightening: Straightening, vectors: np.ndarray, weight: np.ndarray
) -> MixtureProposal:
    """Two distributions about the origin of straight coordinates: one nearly normal, and one with heavier tails."""
    shape = WhiteShape(
        np.array([1.0 - DEFENSIVE, DEFENSIVE]),
        np.zeros((2, proposal.n)),
        np.repeat(np.diag(straightening.spread)[None], 2, axis=0),
        np.array([STRAIGHT_FREEDOM, DEGREES_OF_FREEDOM]),
    )
    tuple_weight = _tuple_weight(proposal, vectors, weight)
    return MixtureProposal(proposal.mixture, straightening.bend, shape, tuple_weight)


def _clustered(
    proposal: MixtureProposal, vectors: np.ndarray, weight: np.ndarray, random: np.random.RandomState
) -> MixtureProposal:
    """A bend fitted to weighted draws, and several distributions fitted to the straightened draws."""
    counts = weight > 0.0
    vectors, weight = vectors[counts], weight[counts]
    white = proposal.white(proposal.rows(vectors), vectors)
    bend = Bend.fitted(white, weight)
    shape = fitted_shape(bend.straightened(white), weight, random)
    return MixtureProposal(proposal.mixture, bend, shape, _tuple_weight(proposal, vectors, weight))


def _tuple_weight(proposal: MixtureProposal, vectors: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Probabilities of the tuples of counts, between those of the Laplace mixture and the weights of draws."""
    laplace = MixtureProposal(proposal.mixture).weight
    drawn = np.bincount(proposal.rows(vectors), weight, minlength=len(laplace))
    return np.asarray(OLD_WEIGHT * laplace + (1.0 - OLD_WEIGHT) * drawn)


def fitted_shape(white: np.ndarray, weight: np.ndarray, random: np.random.RandomState) -> WhiteShape:
    """Student-t distributions fitted to weighted points, beside a standard one with weight `DEFENSIVE`.

    Scale matrices are shrunk towards half the covariance of all points, with the weight of n + 2 points: so they can be factorised where
    few points lie in many dimensions.

    Args:
        white: Points, shape (point, n).
        weight: Their weights, which add up to 1.
        random: Chooses the first means, far from each other.
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
    """First means: each drawn with a probability that grows with the squared distance from those before (k-means++)."""
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
