"""The verdict: named, indistinguishable, partly explained, unexplained, or nothing found; and the causes that are named with it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from estimator.diagnosis import policy
from estimator.rig.rig import Cause

UNKNOWN = "something not in the library"


class Verdict(StrEnum):
    """Outcome of a diagnosis; the words are stable (docs/file-formats.md)."""

    NAMED = "named"
    INDISTINGUISHABLE = "indistinguishable"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"
    NOTHING_FOUND = "nothing_found"

    @property
    def leaves_something(self) -> bool:
        """Whether something is wrong that no stated cause explains."""
        return self in (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED)


@dataclass(frozen=True)
class Alternative:
    """Another cause that a named one could be.

    Attributes:
        probability: Posterior probability, beside the other causes of the credible set and what no list holds.
        expected_log_evidence: Expected log Bayes factor of the named cause against this one from these readings, were the named one true;
            None where this one was not fitted.
    """

    cause: Cause
    probability: float
    expected_log_evidence: float | None


class Family(NamedTuple):
    """Links of the chain at which something acts, whether it is one of the named causes or only looks like one.

    Attributes:
        links: Values of `mixture.links.Link`, those of the causes of a set.
        probability: That it acts at one of them.
    """

    links: tuple[str, ...]
    probability: float


@dataclass(frozen=True)
class NamedCause:
    """One cause of the verdict.

    Attributes:
        cause: Name and place.
        probability: Posterior probability, beside its alternatives and what no list holds.
        alternatives: The other causes of its credible set.
        log_bayes_factor: Against nothing, beside everything else.
        p_not_in_library: Probability that it is something else which no list holds.
        family: Of all these; None where nothing tells it.
    """

    cause: Cause
    probability: float
    alternatives: tuple[Alternative, ...]
    log_bayes_factor: float
    p_not_in_library: float = 0.0
    family: Family | None = None

    def as_if(self, cause: Cause) -> NamedCause:
        """This with one of its alternatives in its place."""
        return replace(self, cause=cause)

    def weighed_by(self, log_density: Mapping[Cause, float]) -> NamedCause:
        """This set with the probabilities of its causes weighed by log densities of more readings, the most probable one first."""
        known = {self.cause: self.probability} | {
            other.cause: other.probability for other in self.alternatives
        }
        highest = max(log_density.values())
        weighed = {cause: p * math.exp(log_density[cause] - highest) for cause, p in known.items()}
        scale = sum(known.values()) / sum(weighed.values())
        first, *others = sorted(weighed, key=lambda cause: -weighed[cause])
        alternatives = tuple(
            Alternative(cause, scale * weighed[cause], None)
            for cause in others
            if scale * weighed[cause] > policy.ALTERNATIVE
        )
        return replace(self, cause=first, probability=scale * weighed[first], alternatives=alternatives)

    @property
    def may_be_unknown(self) -> bool:
        """Whether something that no list holds belongs to its credible set, so that the name is not alone."""
        return self.p_not_in_library > policy.MOST_BESIDE_A_NAME

    @property
    def is_alone(self) -> bool:
        """Whether nothing else is in its credible set."""
        return not (self.alternatives or self.may_be_unknown)
