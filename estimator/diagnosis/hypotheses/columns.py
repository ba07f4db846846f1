"""What a search compares the residual of a fit with: columns of every cause, and families of flexible curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate, candidates, causes_of
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.structure.families import families
from estimator.diagnosis.structure.families.collection import Family
from estimator.effects.circumstances import UNTIL
from estimator.rig.rig import Cause
from estimator.side_by_side import each, meanwhile

TOGETHER = 200  # families that one core weighs at a time


@dataclass(frozen=True)
class Columns:
    """Columns of causes and curves at one fit, which are those of similar fits, weighed anew.

    Attributes:
        fit: Where they were computed.
        asked: Causes that concern the session there.
        pool: Columns of each of them.
        smooth: Families of flexible curves.
    """

    fit: Fit
    asked: Sequence[Cause]
    pool: Sequence[Candidate]
    smooth: Sequence[Family]

    @classmethod
    def at(cls, fit: Fit, limits: Limits) -> Columns:
        """The columns at a fit of all causes that the limits allow."""
        smooth = meanwhile(lambda: families(fit))
        asked = causes_of(fit.rig, fit, limits)
        return cls(fit, asked, candidates(fit, asked), smooth())

    @property
    def n_causes(self) -> int:
        """Number of different causes that have columns."""
        return len({candidate.cause for candidate in self.pool})

    def pool_at(self, fit: Fit) -> list[Candidate]:
        """The columns of the causes, weighed as the readings are at another fit."""
        if fit is self.fit:
            return list(self.pool)
        weight = fit.weight_over(self.fit)
        return [candidate.weighed(weight) for candidate in self.pool]

    def curves_at(self, fit: Fit) -> list[Family]:
        """The flexible curves, weighed as the readings are at another fit."""
        weight = fit.weight_over(self.fit)
        if bool(torch.isclose(weight, weight[:1], rtol=1e-12, atol=0.0).all()):
            return list(self.smooth)  # amplitudes are in units of the noise: a common weight changes nothing
        together = [self.smooth[first : first + TOGETHER] for first in range(0, len(self.smooth), TOGETHER)]
        weighed = each(lambda some: [family.weighed(weight) for family in some], together)
        return list(chain.from_iterable(weighed))


def without_spells(pool: Sequence[Candidate]) -> list[Candidate]:
    """Columns of causes without those that end at an instant, which double them."""
    return [candidate for candidate in pool if UNTIL not in candidate.shapes]
