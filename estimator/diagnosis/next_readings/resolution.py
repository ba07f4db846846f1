"""Resolution of a session, before any cause is named: the smallest visible size of each cause, and causes that it cannot tell apart.

Both follow from the columns of the causes, less what the fit can follow (docs/explanation/what-cannot-be-told-apart.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.calibration.summary import derived_numbers
from estimator.devices import numpy_of
from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.linear import Projector
from estimator.rig.rig import Cause

# Singular value, over the largest, of a direction in which the columns of a cause count
LEAST_DIRECTION = 1e-3
# Visible size at which causes are compared that the session does not show, as in the hidden study
TYPICAL_SIGMA = 8.0
PLAUSIBLE_SD = 3.0  # of its prior, up to which a size of a cause is plausible: 0.3 % lie beyond
# Share of what a cause changes, in squares, that numbers of the rig must follow to be told
MUCH_ABSORBED = 0.5

MOST_ABSORBING, LEAST_ABSORBING = 3, 0.2  # numbers that are told, and how far each must move over the first
WHOLLY = 0.999  # share that free poses follow of what is another word for them
WIDER = 30.0  # how much wider the priors of these poses are then
Hidden = tuple[
    Tensor, dict[str, Any]
]  # how what stays unseen moves the coordinates of a fit, and what of it is told


@dataclass(frozen=True)
class Visible:
    """Smallest visible size of one quantity of a cause.

    Attributes:
        size: Distance from the null that changes the readings by five standard deviations beyond what the fit can follow.
        prior_sd: Standard deviation of its prior.
        at: Shapes of the start at which that is so, such as a place or an instant.
        share_absorbed: Share of its change of the readings, in squares, that free numbers of the rig follow there.
        absorbed_by: Those that follow most, most first.
        hidden_sd: How far it may move a number of the rig, in the number's standard deviations, and stay unseen: of all starts and sizes
            up to the visible one and to the prior's standard deviation. None does that moves free poses alone: then these are right.
        hidden_in: The number that it would move most.
        hidden_size: The size at which it does, distance from the null.
        hidden_at: Shapes of the start at which it does.
        hidden_shift, hidden_from: How far it moves that number, in SI, and from where.
    """

    cause: Cause
    key: str
    unit: str
    size: float
    prior_sd: float
    at: Mapping[str, float] = field(default_factory=dict)
    share_absorbed: float = 0.0
    absorbed_by: tuple[str, ...] = ()
    hidden_sd: float = 0.0
    hidden_in: str = ""
    hidden_size: float = 0.0
    hidden_at: Mapping[str, float] = field(default_factory=dict)
    hidden_shift: float = 0.0
    hidden_from: float = 0.0

    @property
    def is_visible(self) -> bool:
        """Whether a plausible size would show."""
        return self.size < PLAUSIBLE_SD * self.prior_sd

    def to_json(self) -> dict[str, Any]:
        """An entry of `smallest_visible` in `diagnosis.json`."""
        return {
            "size": self.size if self.is_visible else None,
            "unit": self.unit,
            "place": self.cause.place,
            "at": dict(self.at),
            "share_absorbed": self.share_absorbed,
            "absorbed_by": list(self.absorbed_by),
            "hidden_sd": self.hidden_sd,
            "hidden_in": self.hidden_in,
            "hidden_shift": self.hidden_shift,
            "hidden_size": self.hidden_size,
            "hidden_at": dict(self.hidden_at),
        }


def smallest_visible(fit: Fit, pool: Sequence[Candidate]) -> list[Visible]:
    """Smallest visible size of every quantity of every cause, at its best start; infinite where the fit can follow all of it.

    To first order, a change of the readings by a column x moves the numbers of the fit by (J^T J + L)^-1 J^T x.
    """
    best: dict[tuple[Cause, str], Visible] = {}
    hides: dict[tuple[Cause, str], Hidden] = {}
    if not pool:
        return []
    columns = torch.cat([candidate.columns for candidate in pool], dim=1)
    norms = fit.projector.norms(columns)
    lengths = columns.norm(dim=0).clamp(min=1e-300)
    factor = fit.projector.factor
    shifts = factor @ (factor.T @ (fit.jacobian.T @ columns))
    moved_sd = shifts.abs() / torch.diagonal(fit.covariance).sqrt()[:, None]
    names = fit.posterior.coordinates.quantities
    of_noise = torch.tensor([name.endswith(".noise_T") for name in names], device=moved_sd.device)
    moved_sd[of_noise] = 0.0
    are_poses = _are_poses(fit, names, columns)
    begin = 0
    for candidate in pool:
        for i, key in enumerate(candidate.keys):
            n_sigma, moves = float(norms[begin + i]), moved_sd[:, begin + i]
            size = policy.VISIBLE_SIGMA / n_sigma if n_sigma > 0.0 else math.inf
            prior_sd = float(candidate.prior_sd[i])
            most = int(moves.argmax()) if len(names) else 0
            unseen = min(size, prior_sd)
            hidden_sd = unseen * float(moves[most]) if len(names) and not are_poses[begin + i] else 0.0
            asked = (candidate.cause, key)
            if asked not in best or size < best[asked].size:
                share = 1.0 - min(n_sigma / float(lengths[begin + i]), 1.0) ** 2
                order = torch.argsort(moves, descending=True)[:MOST_ABSORBING].tolist() if len(names) else []
                leading = [j for j in order if float(moves[j]) > LEAST_ABSORBING * float(moves[order[0]])]
                by = tuple(names[j] for j in leading) if share > MUCH_ABSORBED else ()
                best[asked] = Visible(*asked, candidate.units[i], size, prior_sd, candidate.shapes, share, by)
            if hidden_sd > (hides[asked][1]["hidden_sd"] if asked in hides else 0.0):
                told = {"hidden_in": names[most], "hidden_size": unseen, "hidden_at": candidate.shapes}
                hides[asked] = unseen * shifts[:, begin + i], {"hidden_sd": hidden_sd, **told}
        begin += len(candidate.keys)
    return list((best | _with_hidden(fit, best, hides)).values())


def _are_poses(fit: Fit, names: Sequence[str], columns: Float[Tensor, "component column"]) -> list[bool]:
    """Whether each column is another word for free poses, such as a coil that sits elsewhere: their priors alone hold them back."""
    free = [i for i, name in enumerate(names) if "_from_" in name]
    wider = fit.prior_precision[free][:, free] / WIDER**2
    rest = Projector.of(fit.jacobian[:, free], wider).norms(columns)
    return (rest.square() < (1.0 - WHOLLY) * columns.square().sum(0)).tolist()


def _with_hidden(
    fit: Fit, best: Mapping[tuple[Cause, str], Visible], hides: Mapping[tuple[Cause, str], Hidden]
) -> dict[tuple[Cause, str], Visible]:
    """Smallest visible sizes with what stays unseen, and how far that moves a number, by how it moves the coordinates of the fit."""
    if not hides:
        return {}
    vectors = torch.cat((fit.vector[None], fit.vector + torch.stack([shift for shift, _ in hides.values()])))
    values = fit.posterior.coordinates.values(vectors)
    free = {name: numpy_of(value) for name, value in values.items() if value.ndim}
    numbers = free | derived_numbers(fit.rig, free)
    told = {}
    for i, (asked, (_, hidden)) in enumerate(hides.items(), start=1):
        start, there = (float(numbers[hidden["hidden_in"]][row]) for row in (0, i))
        told[asked] = replace(best[asked], **hidden, hidden_shift=there - start, hidden_from=start)
    return told


def indistinguishable(fit: Fit, pool: Sequence[Candidate]) -> list[tuple[Cause, ...]]:
    """Groups of causes that this session cannot tell apart if one of them is present at eight standard deviations.

    Two causes belong together where each follows the columns of the other so closely that the expected log evidence between them is below
    log 20. Causes that the fit can follow wholly are left out, for the session cannot show them.
    """
    bases = {cause: _basis(own) for cause, own in _columns(fit, pool).items() if own.shape[1]}
    causes, follows = list(bases), _follows(list(bases.values()))
    twins = {
        cause: [other for other, is_twin in zip(causes, row, strict=True) if is_twin]
        for cause, row in zip(causes, (follows & follows.T).tolist(), strict=True)
    }
    groups: list[tuple[Cause, ...]] = []
    for cause in causes:
        group = tuple(twins[cause])
        if len(group) > 1 and group not in groups:
            groups.append(group)
    return groups


def _columns(fit: Fit, pool: Sequence[Candidate]) -> dict[Cause, Tensor]:
    """Projected columns of each cause, over all its starts, that a plausible size makes visible."""
    by_cause: dict[Cause, list[Candidate]] = {}
    for candidate in pool:
        by_cause.setdefault(candidate.cause, []).append(candidate)
    visible = {}
    for cause, starts in by_cause.items():
        columns = fit.projector.rest(torch.cat([start.columns for start in starts], dim=1))
        prior_sd = torch.cat([start.prior_sd for start in starts])
        is_visible = columns.norm(dim=0) * prior_sd * PLAUSIBLE_SD > policy.VISIBLE_SIGMA
        visible[cause] = columns[:, is_visible]
    return visible


def _basis(columns: Float[Tensor, "component column"]) -> Float[Tensor, "component direction"]:
    """Independent directions that columns span, orthonormal: by eigenvalues, far faster than the singular values of so tall a matrix."""
    scaled = columns / columns.norm(dim=0).clamp(min=1e-300)
    squares, turn = torch.linalg.eigh(scaled.T @ scaled)
    is_kept = squares > LEAST_DIRECTION**2 * squares[-1]
    return scaled @ turn[:, is_kept] / squares[is_kept].sqrt()


def _follows(bases: Sequence[Tensor]) -> Bool[Tensor, "basis followed"]:
    """Whether each basis follows a typical direction of each other so closely that the log evidence hardly differs."""
    if not bases:
        return torch.zeros(0, 0, dtype=torch.bool)
    width = torch.tensor([basis.shape[1] for basis in bases], device=bases[0].device)
    every, number = torch.cat(list(bases), dim=1), torch.repeat_interleave(width)
    squares = (every.T @ every).square()
    rows = squares.new_zeros(len(width), len(number)).index_add(0, number, squares)
    share = squares.new_zeros(len(width), len(width)).index_add(1, number, rows) / width
    return share > 1.0 - policy.CLEAR_LOG_EVIDENCE / (0.5 * TYPICAL_SIGMA**2)
