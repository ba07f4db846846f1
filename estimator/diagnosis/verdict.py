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

    @classmethod
    def among(
        cls, evidence: Mapping[Cause, float], log_bayes_factor: float, p_any: float = 1.0
    ) -> NamedCause:
        """The first of some causes, with those that explain the readings nearly as well.

        Args:
            evidence: Log evidence of each cause, up to a constant.
            log_bayes_factor: Of the first.
            p_any: Probability that one of them is there.
        Examples:
            >>> named = NamedCause.among({Cause("gain", "a"): 0.0, Cause("gain", "b"): -0.5}, 20.0)
            >>> round(named.probability, 2), round(named.alternatives[0].probability, 2)
            (0.62, 0.38)
        """
        highest = max(evidence.values())
        weights = {cause: math.exp(value - highest) for cause, value in evidence.items()}
        scale = p_any / sum(weights.values())
        first, *others = weights
        alternatives = tuple(
            Alternative(cause, scale * weights[cause], None)
            for cause in others
            if scale * weights[cause] > policy.ALTERNATIVE
        )
        return cls(first, scale * weights[first], alternatives, log_bayes_factor, 1.0 - p_any)

    def weighed_by(self, log_density: Mapping[Cause, float]) -> NamedCause:
        """This set with the probabilities of its causes weighed by log densities of more readings, the most probable one first."""
        known = {self.cause: self.probability} | {
            other.cause: other.probability for other in self.alternatives
        }
        evidence = {cause: math.log(p) + log_density[cause] for cause, p in known.items()}
        ranked = dict(sorted(evidence.items(), key=lambda each: -each[1]))
        best = NamedCause.among(ranked, self.log_bayes_factor, sum(known.values()))
        return replace(self, cause=best.cause, probability=best.probability, alternatives=best.alternatives)

    @property
    def may_be_unknown(self) -> bool:
        """Whether something that no list holds belongs to its credible set, so that the name is not alone."""
        return self.p_not_in_library > policy.MOST_BESIDE_A_NAME

    @property
    def is_alone(self) -> bool:
        """Whether nothing else is in its credible set."""
        return not (self.alternatives or self.may_be_unknown)
