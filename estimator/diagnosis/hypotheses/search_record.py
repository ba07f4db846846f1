"""What a search for causes did and found, step by step; `search` makes it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.hypotheses.source_structure import OtherStructures, is_pile
from estimator.diagnosis.hypotheses.step import Step, leaves_structure
from estimator.diagnosis.structure.discrepancy import Discrepancy
from estimator.diagnosis.structure.families.collection import Family
from estimator.diagnosis.structure.pull import Pull, pull_of
from estimator.diagnosis.structure.scatter import Scatter, scatter_of
from estimator.rig.rig import Cause


@dataclass(frozen=True)
class Addition:
    """Causes that were taken together, and the fit with them."""

    causes: tuple[Cause, ...]
    fit: Fit


@dataclass(frozen=True)
class Search:
    """The search for causes, step by step.

    Attributes:
        base, final: Fits before and after.
        steps: For each cause that was taken the comparison with all other hypotheses, in order; the last step took nothing.
        additions: Causes of the final fit, as they were taken.
        dropped: Causes that were taken and later not needed.
        pool: Columns of every cause at the base fit.
        base_discrepancy: Structure in the residual of the base fit.
        curves: Flexible curves, weighed as the readings are at the final fit.
        ended_early: Why it, or the diagnosis after it, ended before the evidence did; empty where it did not.
        other_structures: Other structures of the source, where causes of many kinds had piled up; else None.
    """

    base: Fit
    final: Fit
    steps: tuple[Step, ...]
    additions: tuple[Addition, ...]
    dropped: tuple[Cause, ...]
    pool: tuple[Candidate, ...]
    base_discrepancy: Discrepancy
    curves: tuple[Family, ...]
    ended_early: str = ""
    other_structures: OtherStructures | None = None

    def step_of(self, cause: Cause) -> Step:
        """The step that took a cause."""
        return next(step for step in self.steps if step.taken == cause)

    @property
    def remainder(self) -> Discrepancy:
        """Structure in the residual of the final fit."""
        return self.steps[-1].remainder

    @property
    def added(self) -> list[Cause]:
        """Causes of the final fit beyond the base."""
        return [cause for cause in self.final.rig.effects if cause not in self.base.rig.effects]

    @cached_property
    def scatter(self) -> Scatter:
        """Whether readings scatter otherwise than the final fit says."""
        return scatter_of(self.final)

    @cached_property
    def pull(self) -> Pull:
        """Whether the final fit pulls a number of the rig far from its prior."""
        return pull_of(self.final)

    @property
    def leaves_structure(self) -> bool:
        """Whether the posterior odds favour something unexplained: in the residual, in how readings scatter, or in a number of the rig."""
        return any(leaves_structure(evidence) for evidence in (self.remainder, self.scatter, self.pull))

    @property
    def source_seems_wrong(self) -> bool:
        """Whether causes of many kinds pile up for which no other structure of the source does."""
        return self.other_structures is not None and is_pile(self.added, policy.MOST_KINDS)

    @property
    def log_odds(self) -> float:
        """Posterior log odds of all that was taken, against nothing."""
        n = len(self.final.rig.effects) - len(self.base.rig.effects)
        n_causes = len({candidate.cause for candidate in self.pool})
        log_prior_odds = policy.LOG_PRIOR_CAUSE - math.log(n_causes) - policy.LOG_PRIOR_NOTHING
        return self.final.log_evidence - self.base.log_evidence + n * log_prior_odds
