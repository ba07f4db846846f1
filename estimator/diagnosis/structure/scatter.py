"""Whether readings miss as a fit says that they scatter, or the more at some times, places or moves.

What misses at random leaves no curve, so the bank of curves never sees it: a trigger that comes late now and then, a burst of interference,
a mover that still swings after a long move. The size of each reading's miss tells, along every covariate and from one reading to the next.
It is replaced by the normal score of its rank, so that the evidence is the same for whatever distribution the fit supposes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import log_bayes_factor, log_mean_exp
from estimator.diagnosis.structure.covariates import covariates
from estimator.diagnosis.structure.doubt import Doubt
from estimator.diagnosis.structure.residual_tests import SETTING_DEGREE
from estimator.diagnosis.structure.smooth import legendre, unit_interval
from estimator.effects.stages import NoiseEffect
from estimator.effects.use import uses_of
from estimator.model.nominal import NominalPrediction

SCATTER_AMPLITUDES = (
    0.3,
    1.0,
)  # how far the size of misses depends on something, in standard deviations of their normal scores
# Parts of a session between which readings may scatter more, any number of them in a row
N_INSTANTS_OF_BURSTS = 24

LEAST_SHARE = 0.05  # of a component's variance that the fit leaves it; below, the fit runs through it


@dataclass(frozen=True)
class Scatter(Doubt):
    """Evidence that readings do not scatter as a fit says, averaged over all that it may depend on.

    Attributes:
        along: What it depends on most.
    """

    along: str


def scatter_of(fit: Fit) -> Scatter:
    """The evidence that the readings of a fit scatter otherwise than it says."""
    evidence: dict[str, list[float]] = {}
    best, along = -math.inf, ""
    misses, n_measured = _misses(fit), fit.observations.is_measured.sum(1)
    # Where nothing was measured, nothing misses more or less than elsewhere.
    size = misses.new_zeros(len(misses))
    is_measured = n_measured > 0
    size[is_measured] = _normal_scores(_lengths(misses, n_measured)[is_measured])
    for name, detail, columns in _sizes(fit, size):
        log_bayes_factor = _evidence(columns - columns.mean(0), size)
        evidence.setdefault(name, []).append(log_bayes_factor)
        if log_bayes_factor > best:
            best, along = log_bayes_factor, f"{name}, {detail}" if detail else name
    means = [log_mean_exp(torch.tensor(of_family, dtype=torch.float64)) for of_family in evidence.values()]
    return Scatter(log_mean_exp(torch.tensor(means, dtype=torch.float64)) if means else 0.0, along)


def _misses(fit: Fit) -> Float[Tensor, "reading 3"]:
    """Residual of each reading, in units of what the fit says, the axes decorrelated; 0 where a component was not measured."""
    posterior = fit.posterior
    with torch.no_grad():
        sigma_T = posterior.component_sigma_T(fit.vector)
    share = 1.0 - (fit.jacobian @ fit.projector.factor).square().sum(1)
    residual = fit.residual / (fit.whitening_per_T * sigma_T * share.clamp(min=LEAST_SHARE).sqrt())
    by_reading = _by_reading(fit, residual)[..., None]
    misses: Tensor = torch.linalg.solve_triangular(_factors(fit, sigma_T), by_reading, upper=False)
    return misses[..., 0]


def _factors(fit: Fit, sigma_T: Float[Tensor, " component"]) -> Float[Tensor, "reading 3 3"]:
    """Cholesky factors of the correlation of each reading's components, which causes of scatter may move together."""
    together_T = sigma_T.new_zeros(len(fit.observations), 3, 0)
    prediction = NominalPrediction(fit.posterior.model)
    for use in uses_of(fit.rig, NoiseEffect):
        directions_T = use.effect.directions_T(prediction, use.theta(fit.values), use.place)
        if directions_T is not None:
            together_T = torch.cat((together_T, directions_T), dim=-1)
    whitened = together_T / _by_reading(fit, sigma_T, fill=math.inf)[..., None]
    correlation = whitened @ whitened.mT
    diagonal = torch.diag_embed(1.0 - torch.diagonal(correlation, dim1=-2, dim2=-1))
    return torch.linalg.cholesky(correlation + diagonal)


def _by_reading(fit: Fit, components: Float[Tensor, " component"], fill: float = 0.0) -> Tensor:
    """Components by reading and axis."""
    is_measured = fit.observations.is_measured
    values = components.new_full(is_measured.shape, fill)
    values[is_measured] = components
    return values


def _sizes(fit: Fit, size: Tensor) -> Iterator[tuple[str, str, Tensor]]:
    """What the size of a miss may depend on: name, detail and columns."""
    circumstances = fit.circumstances
    time = 2.0 * circumstances.hours / circumstances.duration_h - 1.0
    yield "time", "slowly", legendre(time, SETTING_DEGREE)[:, 1:]
    order = torch.argsort(fit.observations.row)
    edges = torch.linspace(0, len(order), N_INSTANTS_OF_BURSTS + 1).round().int().tolist()
    for begin, end in combinations(sorted(set(edges)), 2):
        during = size.new_zeros(len(order), 1)
        during[order[begin:end]] = 1.0
        yield "time", "in bursts", during
    before = torch.zeros_like(size)
    before[order[1:]] = size[order[:-1]]
    yield "the reading before", "", before[:, None]
    for covariate in covariates(fit):
        values = unit_interval(covariate.by_reading[:, None])[:, 0]
        yield "one circumstance", covariate.name, legendre(values, 2)[:, 1:]
    for mover in fit.rig.movers:
        length_m = circumstances.last_move_m(mover.name).norm(dim=-1, keepdim=True)
        yield f"the length of the last move of {mover.name}", "", unit_interval(length_m)


def _lengths(misses: Float[Tensor, "reading 3"], n_measured: Tensor) -> Float[Tensor, " reading"]:
    """Size of each reading's miss, comparable between readings with one, two and three measured components.

    References: Wilson and Hilferty, Proc. Natl. Acad. Sci. 17, 684 (1931): cube roots of chi-square are nearly normal.
    """
    share = 2.0 / (9.0 * n_measured.clamp(min=1))
    mean_square = misses.square().sum(1) / n_measured.clamp(min=1)
    return (mean_square ** (1.0 / 3.0) - 1.0 + share) / share.sqrt()


def _normal_scores(values: Float[Tensor, " reading"]) -> Float[Tensor, " reading"]:
    """Normal quantiles of the ranks."""
    rank = torch.argsort(torch.argsort(values)).to(torch.float64)
    return torch.special.ndtri((rank + 0.5) / len(values))


def _evidence(columns: Float[Tensor, "reading column"], score: Float[Tensor, " reading"]) -> float:
    """Log Bayes factor of columns in scores of unit variance, averaged over amplitudes."""
    rms = columns.square().sum(1).mean().sqrt()
    if not bool(rms > 0.0):
        return 0.0
    columns = (columns / rms).to(score.dtype)
    gram, projected = columns.T @ columns, columns.T @ score
    return log_mean_exp(log_bayes_factor(gram, projected, score.new_tensor(SCATTER_AMPLITUDES)))
