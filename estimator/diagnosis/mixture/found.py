"""Sets of alternatives that an answer finds, with their probabilities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from estimator.diagnosis.mixture.imitation import AT_ITS_LINK
from estimator.diagnosis.mixture.links import Link
from estimator.diagnosis.verdict import Family
from estimator.rig.rig import Cause


@dataclass(frozen=True)
class Possibility:
    """One thing that a slot holds in some draws.

    Attributes:
        cause: A listed cause, or the departure that stands for something unlisted.
        is_listed: Whether it is listed.
        link: Where in the chain it acts.
        share: Of the draws of the set; of a listed cause less what only imitates it.
    """

    cause: Cause
    is_listed: bool
    link: Link
    share: float


@dataclass(frozen=True)
class Found:
    """A set of alternatives, of which one is there, or something that no list holds and that looks like it.

    Attributes:
        possibilities: Most probable first.
        probability: That one of them is there, or something that looks like it, beside everything else: that with all readings, and less
            where halves say less than half of what is expected of them.
        with_all, in_halves: With all readings; the mean over halves of them.
        expected: What is expected in halves of what is there as all readings have it.
    """

    possibilities: tuple[Possibility, ...]
    probability: float
    with_all: float
    in_halves: float
    expected: float

    @property
    def first(self) -> Possibility:
        """The most probable possibility."""
        return self.possibilities[0]

    @property
    def listed(self) -> list[Cause]:
        """The listed causes among them."""
        return [possibility.cause for possibility in self.possibilities if possibility.is_listed]

    @property
    def first_listed(self) -> Cause:
        """The most probable listed cause."""
        return self.listed[0]

    @property
    def listed_share(self) -> float:
        """How probable it is that it is a listed cause, if it is there."""
        return sum(possibility.share for possibility in self.possibilities if possibility.is_listed)

    @property
    def family(self) -> Family:
        """The links of the listed causes, and the probability that it acts at one of them."""
        links = tuple(dict.fromkeys(each.link for each in self.possibilities if each.is_listed))
        of_imitations = 1.0 - sum(each.share for each in self.possibilities)
        there = sum(each.share for each in self.possibilities if each.link in links)
        return Family(links, self.probability * (there + AT_ITS_LINK * of_imitations))

    def to_json(self) -> dict[str, Any]:
        """An entry of `causes` or `departures` in `diagnosis.json`."""
        return {
            "probability": self.probability,
            "with_all_readings": self.with_all,
            "in_halves": self.in_halves,
            "expected_in_halves": self.expected,
            "is_one_of": [
                {
                    "name": possibility.cause.name,
                    "place": possibility.cause.place,
                    "is_listed": possibility.is_listed,
                    "link": possibility.link.value,
                    "probability": self.probability * possibility.share,
                }
                for possibility in self.possibilities
            ],
        }
