"""Sizes of what was named: numbers with intervals, and causes with the numbers that the session can see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from estimator.diagnosis.verdict import UNKNOWN, Alternative
from estimator.rig.rig import Cause


@dataclass(frozen=True)
class Interval:
    """One number of the extended rig: its median, standard deviation and 90 % credible interval."""

    median: float
    sd: float
    ci90: tuple[float, float]
    unit: str

    def to_json(self) -> dict[str, Any]:
        """This interval in the form of `diagnosis.json`."""
        return {"median": self.median, "sd": self.sd, "ci90": list(self.ci90), "unit": self.unit}


@dataclass(frozen=True)
class Difference:
    """One quantity of a cause minus another, by their SI keys."""

    plus: str
    minus: str
    interval: Interval

    @property
    def distance_sd(self) -> float:
        """Distance from zero in standard deviations."""
        return abs(self.interval.median) / self.interval.sd if self.interval.sd > 0.0 else 0.0

    def to_json(self) -> dict[str, Any]:
        """This difference in the form of `diagnosis.json`."""
        return {"plus": self.plus, "minus": self.minus, **self.interval.to_json()}


@dataclass(frozen=True)
class SizedCause:
    """A cause of the verdict, or a mistake of the record, with the sizes of its quantities.

    Attributes:
        cause: Name and place.
        name: Of the cause, with its place where the rig has several for it.
        probability: Posterior probability, beside its alternatives and what no list holds.
        p_not_in_library: Probability that it is something else which no list holds.
        may_be_unknown: Whether that belongs to its credible set.
        alternatives: The other causes that it could be.
        alternative_names: Their names, written like `name`.
        log_bayes_factor: Against nothing, when it was taken.
        quantities: Those that the session can see, by SI key.
        is_record_mistake: Whether it is a mistake of the record.
        difference: Of two quantities, where it is known better than any of them.
    """

    cause: Cause
    name: str
    probability: float
    p_not_in_library: float
    may_be_unknown: bool
    alternatives: tuple[Alternative, ...]
    alternative_names: tuple[str, ...]
    log_bayes_factor: float
    quantities: Mapping[str, Interval]
    is_record_mistake: bool = False
    difference: Difference | None = None

    @property
    def others(self) -> tuple[tuple[str, float], ...]:
        """Everything else in its credible set with its probability, most probable first."""
        unknown = [(UNKNOWN, self.p_not_in_library)] if self.may_be_unknown else []
        rivals = zip(self.alternative_names, self.alternatives, strict=True)
        others = [*((name, rival.probability) for name, rival in rivals), *unknown]
        return tuple(sorted(others, key=lambda other: -other[1]))

    def to_json(self) -> dict[str, Any]:
        """This cause in the form of `diagnosis.json`; mistakes of the record have no expected log evidence."""
        alternatives = [
            {"name": name, "probability": alternative.probability}
            | ({} if self.is_record_mistake else {"expected_log_evidence": alternative.expected_log_evidence})
            for name, alternative in zip(self.alternative_names, self.alternatives, strict=True)
        ]
        return {
            "name": self.name,
            "place": self.cause.place,
            "probability": self.probability,
            "p_not_in_library": self.p_not_in_library,
            "may_be_unknown": self.may_be_unknown,
            "alternatives": alternatives,
            "log_bayes_factor": self.log_bayes_factor,
            "parameters": intervals_to_json(self.quantities),
            "difference": None if self.difference is None else self.difference.to_json(),
        }


def intervals_to_json(intervals: Mapping[str, Interval]) -> dict[str, Any]:
    """Intervals by SI key, in the form of `diagnosis.json`."""
    return {key: interval.to_json() for key, interval in intervals.items()}
