"""The contract of an effect: one named cause of a difference between simulation and measurement.

An effect is declared once: where it acts, which quantities say how large it is, what they are when nothing is wrong (null), how large
they are in laboratories (prior), and one function. Simulating with it, screening for it, fitting it and carrying it in a calibrated model
all come from that declaration. A rig holds effects as entries `cause[place]`, whose quantities are parameters like any others.

Most are one function with `cause` of their stage above it; what needs several functions may as well be a class of the stage, with the same
names as attributes.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

from estimator.effects.circumstances import SINCE, UNTIL, Circumstances, Extent
from estimator.effects.declaring import made
from estimator.errors import InvalidInput
from estimator.rig.bodies import Body, Mover
from estimator.rig.parameters import LogNormal, Normal, Prior, Uniform
from estimator.rig.rig import Cause, Rig
from estimator.tensors import Tensor, torch

Theta = Mapping[str, Tensor]  # quantities by key, each with the batch of the hypothesis
Starts = tuple[dict[str, float], ...]  # shapes that fits start from, by key


LEAST_SHARE = -0.9  # a tenth of what was stated is left
AFTER = 1.0 + 1e-6  # of the duration of a session: after its last reading
WHEN = "when it happened in a session that has not begun"  # what a cause with an instant depends on


class Kind(StrEnum):
    """What an effect belongs to; a rig with several of them has the effect several times."""

    COIL = "coil"
    SENSOR = "sensor"
    MOVER = "mover"
    ROOM = "room"
    RECORD = "record"


@dataclass(frozen=True)
class Rule:
    """What a value must be.

    Attributes:
        words: As messages have it: `must be > 0`.
        holds: Whether a value is so.
    """

    words: str
    holds: Callable[[float], bool]


POSITIVE = Rule("must be > 0", lambda value: value > 0.0)
SIGN = Rule("must be 1 or -1", lambda value: abs(value) == 1.0)


def whole(words: str, lowest: float, highest: float = math.inf) -> Rule:
    """The rule that a value must be whole and in a range."""
    return Rule(words, lambda value: float(value).is_integer() and lowest <= value <= highest)


@dataclass(frozen=True)
class Quantity:
    """One number of an effect.

    Attributes:
        key: Name with its SI unit as suffix; pure numbers have none.
        unit: SI unit; "1" for pure numbers.
        prior: What is known of it where the effect is present.
        null: Value at which it changes nothing.
        is_shape: Says where or how the effect acts and does nothing by itself: a position, a time constant.
        is_fixed: A shape that a fit leaves where the start has put it: an instant, an axis.
        rule: What a value in a rig file must be.
    """

    key: str
    unit: str
    prior: Prior
    null: float = 0.0
    is_shape: bool = False
    is_fixed: bool = False
    rule: Rule | None = None

    @property
    def is_positive(self) -> bool:
        """Fitted as a logarithm."""
        return isinstance(self.prior, LogNormal)

    def widened(self, factor: float) -> Quantity:
        """This quantity with a prior so many times as wide; shapes and positive quantities stay."""
        if self.is_shape or not isinstance(self.prior, Normal):
            return self
        return replace(self, prior=replace(self.prior, standard_deviation=factor * self.prior.sd))


Quantities = tuple[Quantity, ...]


def normal(key: str, unit: str, sd: float, null: float = 0.0) -> Quantity:
    """A quantity that scatters normally about its null."""
    return Quantity(key, unit, Normal(null, sd), null)


def pure(**widths: float) -> Quantities:
    """Pure numbers that scatter normally about zero, each with its standard deviation: `pure(excess=0.01)`."""
    return tuple(normal(key, "1", sd) for key, sd in widths.items())


def share(**widths: float) -> Quantities:
    """Relative changes of numbers that stay positive: pure numbers that scatter normally about zero and are never near -1."""
    return tuple(Quantity(key, "1", Normal(0.0, sd, lower=LEAST_SHARE)) for key, sd in widths.items())


def at_least_zero(key: str, unit: str, sd: float) -> Quantity:
    """A quantity that cannot be negative, half-normal above zero."""
    return Quantity(key, unit, Normal(0.0, sd, lower=0.0))


def triple(keys: Iterable[str], suffix: str, unit: str, sd: float) -> Quantities:
    """Quantities alike but for their first letters: `triple("xyz", "_T", "T", 1e-5)`."""
    return tuple(normal(f"{key}{suffix}", unit, sd) for key in keys)


def vector(theta: Theta, keys: Iterable[str], suffix: str = "") -> Tensor:
    """Quantities alike but for their first letters as vectors, with an axis of length 1 for readings, points or poses.

    Examples:
        >>> vector({"x_T": torch.zeros(5), "y_T": torch.ones(5)}, "xy", "_T").shape
        torch.Size([5, 1, 2])
    """
    return torch.stack([theta[f"{key}{suffix}"] for key in keys], dim=-1)[..., None, :]


def shape(key: str, unit: str, lower: float, upper: float, is_fixed: bool = False) -> Quantity:
    """A shape that may lie anywhere in a range."""
    return Quantity(key, unit, Uniform(lower, upper), 0.5 * (lower + upper), True, is_fixed)


def at_most(key: str, unit: str, lower: float, upper: float, largest: float) -> Quantity:
    """A limit, from and to such multiples of the largest value, beyond which it limits nothing."""
    return Quantity(key, unit, Uniform(lower * largest, upper * largest), upper * largest)


def fixed(key: str, unit: str, lower: float, upper: float, rule: Rule | None = None) -> Quantity:
    """A shape that a fit leaves where a start has put it."""
    return Quantity(key, unit, Uniform(lower, upper), 0.5 * (lower + upper), True, True, rule)


def box(keys: Iterable[str], suffix: str, unit: str, end: float, is_fixed: bool = False) -> Quantities:
    """Shapes alike but for their first letters, each from `-end` to `end`."""
    return tuple(shape(f"{key}{suffix}", unit, -end, end, is_fixed) for key in keys)


def written(numbers: Mapping[str, float]) -> dict[str, float]:
    """Numbers as rig files hold them: six digits."""
    return {key: float(f"{number:.6g}") for key, number in numbers.items()}


def switch(key: str, lower: float, upper: float, null: float, rule: Rule | None = None) -> Quantity:
    """A number of a cause that is set and never fitted."""
    return Quantity(key, "1", Uniform(lower, upper), null, True, True, rule)


def since(extent: Extent) -> Quantity:
    """The time since the session began at which something happened, one of `Circumstances.instants_h`."""
    return fixed(SINCE, "h", 0.0, extent.duration_h)


def until(extent: Extent) -> Quantity:
    """The time since the session began at which something ended, one of `Circumstances.instants_h`."""
    return fixed(UNTIL, "h", 0.0, AFTER * extent.duration_h)


class Effect(ABC):
    """A cause. Subclasses say at which stage of the measurement model they act.

    Attributes:
        name: Stable name of the cause, as in `diagnosis.json`.
        kind: What it belongs to.
        words: What has happened, in a few words, for reports.
        source: Where the width of its priors comes from.
        changes_field: It changes the field that a calibration predicts; else only how readings of it came about.
        is_record_mistake: It is there or not, and makes the readings absurd unless undone. All its starts are tried before any other cause.
        is_structural: The source is built otherwise than described.
        is_linear: The field stays proportional to the currents.
        can_begin: It may be there in one session and not in the one before. What is built into a winding, or is a formula, was there from
            the first reading on: beside a calibration of the same coil it explains no change.
        needs_winding: It says something of a round winding, or has a place beside one; other coils cannot have it.
        stays: The cause that is the same from one instant on, where this one ends at another: the difference of two of these.
        repeats: The cause of which this is one more, such as a second piece of iron; it is asked where that one is there.
        never_negative: Keys of quantities that are not negative where the cause is what its words say: a current that grows as a coil warms
            up is none of its losses. A fit with a negative one is something else.
        depends_on: What of a session its quantities depend on, so that the field of a single moment cannot show them; None where it can.
        is_everywhere: No laboratory is without it, so a calibration fits it where the rig file does not mention it.
        is_in_every_device: Every device has it, of a size that makers state: what a measurement promises must hold beside it.
        is_correction: It names no cause. It is never asked as one, and corrects predictions where something is left that no cause explains.
    """

    name: ClassVar[str]
    kind: ClassVar[Kind]
    words: ClassVar[str]
    source: ClassVar[str]
    changes_field: ClassVar[bool] = False
    is_record_mistake: ClassVar[bool] = False
    is_structural: ClassVar[bool] = False
    is_linear: ClassVar[bool] = True
    can_begin: ClassVar[bool] = True
    needs_winding: ClassVar[bool] = False
    stays: ClassVar[Effect | None] = None
    repeats: ClassVar[Effect | None] = None
    never_negative: ClassVar[tuple[str, ...]] = ()
    depends_on: ClassVar[str | None] = None
    is_everywhere: ClassVar[bool] = False
    is_in_every_device: ClassVar[bool] = False
    is_correction: ClassVar[bool] = False

    @classmethod
    def cause(
        cls,
        method: str | None = None,
        /,
        *,
        quantities: Quantities | Callable[[Extent], Quantities],
        **others: Any,
    ) -> Callable[[Callable[..., Any]], Self]:
        """Make an effect of this stage of a function, which has its name.

        The first line of the function's docstring is `words`, a last paragraph `Source: ...` is `source`, and what is between explains the
        effect in reports and `coilcal explain`. The function, and others that are given, take those arguments of the stage that they
        need, by name.

        Args:
            method: What of the stage the function is; needed where the stage has several, as the room has steady and drifting fields.
            quantities: Its numbers, or a function where their priors depend on the session.
            **others: Further attributes and methods of the stage: `is_linear=False`, `starts=...`.
        Returns: What makes the effect of the function.
        Raises:
            InvalidInput: It is not clear which method it is, the stage has no such attribute or argument, or words are missing.
        Examples:
            >>> from estimator.effects.stages import ReadingEffect
            >>> @ReadingEffect.cause(quantities=lambda extent: (normal("excess_per_T", "1/T", 0.02 / extent.largest_field_T),))
            ... def bent_amplifier(field_sensor_T, theta):
            ...     '''Both signs of a large field read too high.
            ...
            ...     The amplifier bends.
            ...
            ...     Source: amplifiers of this kind, 2 % at the end of the range.
            ...     '''
            ...     return field_sensor_T + theta["excess_per_T"][..., None, None] * field_sensor_T**2
            >>> bent_amplifier.name, bent_amplifier.words
            ('bent_amplifier', 'both signs of a large field read too high')
        """
        declared: dict[str, Any] = {"quantities": quantities, **others}

        def joined(function: Callable[..., Any]) -> Any:
            left_open = {method} if method else cls.__abstractmethods__ - declared.keys()
            if len(left_open) != 1:
                name, which = function.__name__.strip("_"), " and ".join(sorted(left_open)) or "none"
                raise InvalidInput(
                    f"{name} must say which method of {cls.__name__} it is; received no name, and open are {which}"
                )
            return made(cls, function, declared, *left_open)

        return joined

    @abstractmethod
    def quantities(self, extent: Extent) -> Quantities:
        """Numbers that this cause has in a session like this one."""

    def extent_of(self, keys: Iterable[str]) -> Extent:
        """An extent in which its quantities have these keys; the default where keys do not depend on it."""
        return Extent()

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """Shapes to start fits from; none needed where the effect has no shapes."""
        return ({},)

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Names of the coils, sensors or movers that may have it; `room` for the room."""
        if self.kind in (Kind.ROOM, Kind.RECORD):
            return (str(self.kind),)
        bodies: dict[Kind, tuple[Body | Mover, ...]] = {
            Kind.COIL: rig.round if self.needs_winding else rig.coils,
            Kind.SENSOR: rig.sensors,
            Kind.MOVER: rig.movers,
        }
        return tuple(body.name for body in bodies[self.kind])

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the session could show it; a cause that needs a temperature does not concern one without a thermometer."""
        return self.repeats is None or Cause(self.repeats.name, place) in circumstances.rig.effects

    def unseen(self, circumstances: Circumstances, place: str) -> frozenset[str]:
        """Keys of quantities that the session cannot show, or not beside the others: they keep their value."""
        return frozenset()

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """The first quantity whose value it cannot have, and the rule; None where all are possible."""
        quantities = self.quantities(Extent())
        rules = {quantity.key: quantity.rule for quantity in quantities if quantity.rule}
        if rules:
            broken = ((key, rule.words) for key, rule in rules.items() if not rule.holds(values[key]))
            return next(broken, None)
        for quantity in quantities:
            low, high = quantity.prior.lower, quantity.prior.upper
            is_bounded = quantity.is_fixed and quantity.unit == "1"
            if is_bounded and not low <= values[quantity.key] <= high:
                return quantity.key, f"must lie between {low:g} and {high:g}"
        return None

    def meaning(self, values: Mapping[str, float]) -> str:
        """What the numbers of a mistake of the record mean, in words; empty where they speak for themselves."""
        return ""

    def is_itself(self, theta: Theta, circumstances: Circumstances) -> bool:
        """Whether what was fitted still is what the cause says, and not a small correction or the limit of something else."""
        return all(float(theta[key]) >= 0.0 for key in self.never_negative)

    def beyond_the_moment(self, key: str) -> str | None:
        """What of a session a quantity depends on; all of them on the same, unless said otherwise."""
        return self.depends_on
