"""Sizes of what was named: numbers with intervals, and causes with the numbers that the session can see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from estimator.diagnosis.verdict import UNKNOWN, Alternative, NamedCause
from estimator.effects import EFFECTS
from estimator.reporting.numbers import Display, displays, interval_with_unit, quantity_words
from estimator.rig.rig import Cause


@dataclass(frozen=True)
class Interval:
    """One number of the extended rig: its median, standard deviation and 90 % credible interval.

    Attributes:
        is_of_prior: Whether the readings narrow it by less than a fifth: it is mostly what its prior says.
    """

    median: float
    sd: float
    ci90: tuple[float, float]
    unit: str
    is_of_prior: bool = False

    @property
    def words(self) -> str:
        """The median with its interval, in the unit of its order."""
        words = interval_with_unit(self.median, *self.ci90, self.unit)
        return f"{words}, mostly its prior" if self.is_of_prior else words

    def display(self, name: str) -> Display:
        """How a number with this name and size is shown: a share in per cent, all others as `displays` has them."""
        shown = displays([name])[name]
        is_share = self.unit == "1" and abs(self.median) < 1.0
        return replace(shown, unit="%", factor=100.0) if is_share else shown


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

    @property
    def name(self) -> str:
        """Both quantities, in words."""
        return f"{quantity_words(self.plus)} − {quantity_words(self.minus)}"

    @property
    def words(self) -> str:
        """The difference with its 90 % interval."""
        return f"{self.name} {self.interval.words}"

    def to_json(self) -> dict[str, Any]:
        """This difference in the form of `diagnosis.json`."""
        return {"plus": self.plus, "minus": self.minus, **asdict(self.interval)}


@dataclass(frozen=True)
class SizedCause:
    """A cause of the verdict, or a mistake of the record, with the sizes of its quantities.

    Attributes:
        named: The cause, how probable it is, and what else it may be.
        name: Of the cause, with its place where the rig has several for it.
        alternative_names: Of what else it may be, written like `name`.
        quantities: Those that the session can see, by SI key.
        is_record_mistake: Whether it is a mistake of the record.
        difference: Of two quantities, where it is known better than any of them.
    """

    named: NamedCause
    name: str
    alternative_names: tuple[str, ...]
    quantities: Mapping[str, Interval]
    is_record_mistake: bool = False
    difference: Difference | None = None

    @property
    def cause(self) -> Cause:
        """Name and place."""
        return self.named.cause

    @property
    def probability(self) -> float:
        """Posterior probability, beside its alternatives and what no list holds."""
        return self.named.probability

    @property
    def words(self) -> str:
        """What is wrong, in words."""
        return EFFECTS[self.cause.name].words

    @property
    def sizes(self) -> list[tuple[str, Interval]]:
        """Quantities by their names in words."""
        return [(quantity_words(key, self.quantities), size) for key, size in self.quantities.items()]

    @property
    def rivals(self) -> list[tuple[str, Alternative]]:
        """The other causes that it could be, by their names."""
        return list(zip(self.alternative_names, self.named.alternatives, strict=True))

    @property
    def others(self) -> tuple[tuple[str, float], ...]:
        """Everything else in its credible set with its probability, most probable first."""
        unknown = [(UNKNOWN, self.named.p_not_in_library)] if self.named.may_be_unknown else []
        others = [*((name, rival.probability) for name, rival in self.rivals), *unknown]
        return tuple(sorted(others, key=lambda other: -other[1]))

    def to_json(self) -> dict[str, Any]:
        """This cause in the form of `diagnosis.json`; mistakes of the record have no expected log evidence."""
        alternatives = [
            {"name": name, "probability": alternative.probability}
            | ({} if self.is_record_mistake else {"expected_log_evidence": alternative.expected_log_evidence})
            for name, alternative in self.rivals
        ]
        return {
            "name": self.name,
            "place": self.cause.place,
            "probability": self.probability,
            "p_not_in_library": self.named.p_not_in_library,
            "may_be_unknown": self.named.may_be_unknown,
            "family": None if self.named.family is None else self.named.family._asdict(),
            "alternatives": alternatives,
            "log_bayes_factor": self.named.log_bayes_factor,
            "parameters": intervals_to_json(self.quantities),
            "difference": None if self.difference is None else self.difference.to_json(),
        }


def intervals_to_json(intervals: Mapping[str, Interval]) -> dict[str, Any]:
    """Intervals by SI key, in the form of `diagnosis.json`."""
    return {key: asdict(interval) for key, interval in intervals.items()}
