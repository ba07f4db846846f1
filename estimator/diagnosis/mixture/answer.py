"""What is read off the draws: causes with their alternatives, links at which something acts that no list holds, and sizes."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.comparison import Comparison, Left, left_beside
from estimator.diagnosis.mixture.found import Found, Possibility
from estimator.diagnosis.mixture.imitation import AT_OWN_LINK, Standing
from estimator.diagnosis.mixture.links import Link
from estimator.diagnosis.mixture.relatives import evidence_of_relatives
from estimator.diagnosis.mixture.rivals import Rival
from estimator.diagnosis.mixture.slots import Samples
from estimator.rig.rig import Cause

ASKED = 0.2  # probability of a cause from which on a set is made about it
ALIKE = 9  # digits of a probability: equally sure causes keep the order of the items, however their last digits are rounded


@dataclass(frozen=True)
class Answer:
    """Which causes and departures stand beside each other in the readings of a session.

    Attributes:
        first: About the rig as described.
        asked: At the expansion that counts.
        in_halves: Draws from halves of the readings.
        expected: Probability that halves are expected to give each leading item, by its number.
        ended_early: Why it ended before all was asked; empty where it did not.
        refused: Causes that full fits do not bear out, so that they were not asked any more.
        rivals: Of stated causes, by full fits in their place.
        fits: Those that were made of it (`full_fits.py`), by the causes and the departures that were taken from the readings.
    """

    first: Asked
    asked: Asked
    in_halves: tuple[Samples, ...] = ()
    expected: Mapping[int, float] = field(default_factory=dict)
    ended_early: str = ""
    refused: frozenset[Cause] = frozenset()
    rivals: Mapping[Cause, tuple[Rival, ...]] = field(default_factory=dict)
    fits: dict[tuple[Hashable, ...], Fit] = field(default_factory=dict, repr=False, compare=False)

    @property
    def plain(self) -> Fit:
        """Fit of the rig as described."""
        return self.asked.expansion.plain

    @cached_property
    def both(self) -> Samples:
        """Draws with all readings and with halves of them, each half of the whole."""
        return self.asked.samples.joined(self.in_halves)

    @cached_property
    def found(self) -> tuple[Found, ...]:
        """Sets of alternatives about listed causes and departures, most probable first."""
        items, present = self.asked.dictionary.items, self.both.present
        by_cause: dict[Cause, float] = {}
        for item, probability in zip(items, present, strict=True):
            by_cause[item.cause] = by_cause.get(item.cause, 0.0) + float(probability)
        result, told = list[Found](), set[Cause]()
        for cause in sorted(by_cause, key=lambda cause: -round(by_cause[cause], ALIKE)):
            if by_cause[cause] < ASKED or cause in told:
                continue
            shares = {other: share for other, share in self._shares(cause).items() if other not in told}
            told |= set(shares)
            result.append(self._found(shares))
        return tuple(sorted(result, key=lambda entry: -round(entry.probability, ALIKE)))

    def _shares(self, cause: Cause) -> dict[Cause, float]:
        """What the slot of a cause holds, as shares; the cause itself has one of the largest."""
        items = self.asked.dictionary.items
        total: dict[Cause, float] = {}
        for drawn, conditional in self.both.beside.items():
            if items[drawn].cause == cause:
                for item, probability in zip(items, conditional, strict=True):
                    total[item.cause] = total.get(item.cause, 0.0) + float(probability)
        whole = sum(total.values())
        alternatives = {
            other: share
            for other, share in total.items()
            if other == cause or share > policy.ALTERNATIVE * whole
        }
        of_them = sum(alternatives.values())
        return {other: share / of_them for other, share in alternatives.items()}

    @cached_property
    def only_beside(self) -> frozenset[Cause]:
        """Listed causes that are asked beside others alone."""
        listed = frozenset(item.cause for item in self.asked.dictionary.items if item.is_listed)
        return listed.difference(candidate.cause for candidate in self.first.pool)

    def _found(self, shares: dict[Cause, float]) -> Found:
        items = self.asked.dictionary.items
        first = {item.cause: item for item in reversed(items)}
        own = [i for i, item in enumerate(items) if item.cause in shares]
        with_all = self.asked.samples.one_of(own)
        in_halves = self._in_halves(own)
        alternatives = tuple(shares)
        listed, whole = [cause for cause in shares if first[cause].is_listed], sum(shares.values())
        likeliest = max(listed, key=shares.__getitem__, default=None)
        real = 1.0 if likeliest is None else 1.0 - self.standing(likeliest, alternatives).p_imitation
        of_listed = sum(shares[cause] for cause in listed)
        if likeliest is not None:
            likely = shares[likeliest]
            shares = shares | {other.cause: likely * other.odds for other in self.rivals.get(likeliest, ())}
        with_rivals = sum(share for cause, share in shares.items() if first[cause].is_listed)
        possibilities = [
            Possibility(
                cause,
                at.is_listed,
                at.link,
                share / whole * (real * of_listed / with_rivals if at.is_listed else AT_OWN_LINK),
            )
            for cause, share in shares.items()
            for at in [first[cause]]
        ]
        possibilities.sort(key=lambda possibility: -possibility.share)
        expected = self._expected(own)
        probability = with_all
        if self.in_halves and 2.0 * in_halves < expected:
            probability *= 2.0 * in_halves / expected
        return Found(tuple(possibilities), probability, with_all, in_halves, expected)

    def standing(self, cause: Cause, alternatives: Collection[Cause]) -> Standing:
        """How clear a listed cause or one of its alternatives is, and beside what.

        Args:
            cause: The most probable one.
            alternatives: The possibilities of its set, itself among them.
        """
        asked, item = self.asked, self.item_of(cause)
        items = asked.dictionary.items
        own = [i for i, each in enumerate(items) if each.cause in alternatives]
        rest = [i for i in asked.leading if items[i].cause not in alternatives]
        names = [i for i in rest if items[i].is_listed]
        evidence = self._evidence_of([*rest, item])
        relative = evidence_of_relatives(asked, item)
        shortage = max(self._expected(own) - self._in_halves(own), 0.0) if self.in_halves else 0.0
        strongest = max((evidence[i] for i in names), default=0.0)
        return Standing(evidence[item], strongest, relative, len(names), items[item].is_chosen, shortage)

    def _evidence_of(self, chosen: Sequence[int]) -> dict[int, float]:
        """Log Bayes factor of each of some items beside the others."""
        return self.asked.slots.products.gains(chosen, self.asked.noise)

    def _expected(self, own: Sequence[int]) -> float:
        """Probability that halves are expected to give items of a set; as if they were sure of it where none were asked."""
        return max((self.expected.get(i, 0.0) for i in own), default=0.0) if self.in_halves else 1.0

    def _in_halves(self, own: Sequence[int]) -> float:
        """Probability that a slot holds one of some items: the mean over halves, or with all readings where none were asked."""
        samples = self.in_halves or (self.asked.samples,)
        return sum(each.one_of(own) for each in samples) / len(samples)

    @cached_property
    def evidence_of_names(self) -> list[float]:
        """Log Bayes factor of each listed cause that leads, beside all else."""
        evidence, items = self._evidence_of(self.asked.leading), self.asked.dictionary.items
        return [value for i, value in evidence.items() if items[i].is_listed]

    @cached_property
    def is_full(self) -> bool:
        """Whether the leading set fills all slots and one more would be filled too: more is wrong at once than is asked for."""
        asked = self.asked
        if (
            not 1 < asked.slots.n_slots <= len(asked.leading)
        ):  # the only cause that was asked for may be stated
            return False
        return float(asked.slots.conditional(asked.leading, asked.noise_number)[-1]) < 0.5

    @cached_property
    def stated(self) -> tuple[Found, ...]:
        """Sets that are there at `policy.STATED` or more and are rather a listed cause."""
        return tuple(
            entry
            for entry in self.found
            if entry.probability >= policy.STATED
            and entry.listed_share > 0.5
            and (not self.is_full or self._outweighs_the_rest(entry))
        )

    def _outweighs_the_rest(self, entry: Found) -> bool:
        """Whether a set has more than twice the evidence that any item has beside all slots: what is not asked for could imitate less."""
        own = self.in_place_of(entry).log_bayes_factor(entry.listed)
        return own > policy.OUTWEIGHS * self._most_beside_all

    @cached_property
    def _most_beside_all(self) -> float:
        """Highest log Bayes factor of an item beside all slots."""
        asked = self.asked
        return float(asked.slots.evidence(asked.leading, asked.noise_number).max())

    @cached_property
    def _by_rival(self) -> dict[Cause, Rival]:
        return {other.cause: other for rivals in self.rivals.values() for other in rivals}

    @cached_property
    def beside(self) -> tuple[Found, ...]:
        """Other sets that are rather there than not."""
        return tuple(entry for entry in self.found if entry not in self.stated and entry.probability > 0.5)

    @cached_property
    def unlisted(self) -> dict[Link, float]:
        """Probability of each link that something acts there which no list holds, beside the causes."""
        items = self.asked.dictionary.items
        result = {}
        for link in dict.fromkeys(item.link for item in items):
            own = [i for i, item in enumerate(items) if item.link is link and not item.is_listed]
            if own:
                result[link] = AT_OWN_LINK * self.both.holding(own)
        return result

    @cached_property
    def p_unlisted(self) -> float:
        """Probability that something acts which no list holds."""
        items = self.asked.dictionary.items
        return self.both.holding([i for i, item in enumerate(items) if not item.is_listed])

    @property
    def leaves_something(self) -> bool:
        """Whether something beside what is stated is rather there than not."""
        is_unlisted = any(probability > 0.5 for probability in self.unlisted.values())
        return self.is_full or bool(self.beside) or is_unlisted

    @cached_property
    def leading_as_stated(self) -> tuple[int, ...]:
        """The most probable set of items, with stated causes in the place of departures that take their slots as well."""
        items = self.asked.dictionary.items
        own = {
            possibility.cause: self.item_of(entry.first_listed)
            for entry in self.stated
            for possibility in entry.possibilities
            if not possibility.is_listed
        }
        return tuple(dict.fromkeys(own.get(items[i].cause, i) for i in self.asked.leading))

    def item_of(self, cause: Cause) -> int:
        """Number of the item that stands for a cause: the one in the leading set, else the most probable one."""
        if cause in self._by_rival:
            return self._by_rival[cause].item
        own = [i for i, item in enumerate(self.asked.dictionary.items) if item.cause == cause]
        in_leading = [i for i in own if i in self.asked.leading]
        return in_leading[0] if in_leading else max(own, key=lambda i: float(self.both.present[i]))

    def sizes_of(self, item: int) -> Float[Tensor, " column"]:
        """Coefficients of an item's columns, beside the leading set."""
        return self.asked.sizes_of(item, [i for i in self.asked.leading if i != item])

    def shapes_of(self, cause: Cause) -> dict[str, float]:
        """Shapes of a cause: as fitted where the expansion has it or it was fitted as a rival, else those of its start."""
        start = self.asked.dictionary.items[self.item_of(cause)].start
        values = self.asked.expansion.fit.values
        if cause in self._by_rival:
            return {key: self._by_rival[cause].shapes[key] for key in start}
        own = {key: values.get(f"{cause.label}.{key}") for key in start}
        return {key: start[key] if value is None else float(value) for key, value in own.items()}

    def beside_item(self, item: int, taken: Sequence[Cause] = ()) -> Comparison:
        """All hypotheses in the place of an item of the leading set, and of others of the same set of alternatives."""
        items = self.asked.dictionary.items
        rest = tuple(i for i in self.asked.leading if i != item and items[i].cause not in taken)
        return Comparison(self.asked, rest, tuple(taken))

    def in_place_of(self, entry: Found) -> Comparison:
        """All hypotheses in the place of the listed causes of a set."""
        return self.beside_item(self.item_of(entry.first_listed), entry.listed)

    def share_moved(self, cause: Cause) -> float:
        """Share of the asked components that a listed cause moves: the inverse participation ratio of the squares of its change."""
        item = self.item_of(cause)
        square = self.beside_item(item).change(item).square()
        return float(square.sum().square() / square.square().sum() / len(square))

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """All hypotheses in the place of each stated cause; last, beside all that leads."""
        return (*map(self.in_place_of, self.stated), Comparison(self.asked, self.asked.leading))

    @property
    def alone(self) -> Comparison:
        """All hypotheses before anything is there."""
        return Comparison(self.first, ())

    @cached_property
    def left(self) -> Left:
        """What no list holds, beside the listed causes that lead."""
        items = self.asked.dictionary.items
        return left_beside(Comparison(self.asked, tuple(i for i in self.asked.leading if items[i].is_listed)))

    def to_json(self) -> dict[str, Any]:
        """Content of `mixture` in `diagnosis.json`."""
        return {
            "found": [entry.to_json() for entry in self.found],
            "unlisted": {link.value: probability for link, probability in self.unlisted.items()},
        }
