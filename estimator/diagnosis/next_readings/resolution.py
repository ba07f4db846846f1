"""What a session can reveal, computed before anything is named: the smallest visible size of each cause, and which cannot be told apart.

Everything follows from the columns of the causes after projection on what the fit can follow (DESIGN section 4).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.rig.rig import Cause


@dataclass(frozen=True)
class Visible:
    """How small a quantity of a cause may be and still show.

    Attributes:
        size: Value that changes the readings by five standard deviations beyond what the fit can follow.
        prior_sd: Its prior width: a size beyond it will hardly occur.
    """

    cause: Cause
    key: str
    unit: str
    size: float
    prior_sd: float

    @property
    def is_visible(self) -> bool:
        """Whether a plausible size would show."""
        return self.size < policy.PLAUSIBLE_SD * self.prior_sd


def smallest_visible(fit: Fit, pool: Sequence[Candidate]) -> list[Visible]:
    """Of every quantity of every cause; the best of its starts, infinite where the fit follows it wholly."""
    best: dict[tuple[Cause, str], Visible] = {}
    for candidate in pool:
        norm = torch.diagonal(fit.projector.gram(candidate.columns, candidate.columns)).clamp(min=0.0).sqrt()
        for i, key in enumerate(candidate.keys):
            n_sigma = float(norm[i])
            size = policy.VISIBLE_SIGMA / n_sigma if n_sigma > 0.0 else math.inf
            own = Visible(candidate.cause, key, candidate.units[i], size, float(candidate.prior_sd[i]))
            known = best.get((candidate.cause, key))
            if known is None or own.size < known.size:
                best[candidate.cause, key] = own
    return list(best.values())


def indistinguishable(fit: Fit, pool: Sequence[Candidate]) -> list[tuple[Cause, ...]]:
    """Groups of causes that this session could not tell apart, were one of them there at eight standard deviations.

    Two causes belong together where, for every quantity of the one, the other follows its columns so closely that the expected
    difference in log evidence stays below log 20. Causes that the fit follows wholly are left out: they cannot show at all.
    """
    bases = {cause: _span(columns) for cause, columns in _columns(fit, pool).items()}
    causes = [cause for cause, basis in bases.items() if basis.shape[1]]
    twins = {cause: {cause} for cause in causes}
    for one in causes:
        for other in causes:
            if one != other and _follows(bases[other], bases[one]) and _follows(bases[one], bases[other]):
                twins[one].add(other)
    groups: list[tuple[Cause, ...]] = []
    for cause in causes:
        group = tuple(c for c in causes if c in twins[cause])
        if len(group) > 1 and group not in groups:
            groups.append(group)
    return groups


def _columns(fit: Fit, pool: Sequence[Candidate]) -> dict[Cause, Tensor]:
    """Columns of each cause over all its starts that a plausible size makes visible, projected."""
    found: dict[Cause, list[Tensor]] = {}
    for candidate in pool:
        own = fit.projector.rest(candidate.columns)
        visible = own.norm(dim=0) * candidate.prior_sd * policy.PLAUSIBLE_SD > policy.VISIBLE_SIGMA
        found.setdefault(candidate.cause, []).append(own[:, visible])
    return {cause: torch.cat(parts, dim=1) for cause, parts in found.items()}


def _span(columns: Tensor) -> Tensor:
    """Orthonormal basis of columns."""
    if not columns.shape[1]:
        return columns
    scaled = columns / columns.norm(dim=0).clamp(min=1e-300)
    left, size, _ = torch.linalg.svd(scaled, full_matrices=False)
    kept: Tensor = left[:, size > policy.LEAST_DIRECTION * size[0]]
    return kept


def _follows(basis: Tensor, other: Tensor) -> bool:
    """Whether a basis follows the typical direction of another so closely that the evidence hardly differs."""
    kept = (basis.T @ other).square().sum() / other.shape[1]
    return float(0.5 * policy.TYPICAL_SIGMA**2 * (1.0 - kept)) < policy.CONFUSED_WITHIN
