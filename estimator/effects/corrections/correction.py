"""The contract of a correction: a smooth field or response that physics allows, for what is left where no known cause explains it.

A correction is an effect without a name for what has happened: of a target, which says what it corrects, and a basis, which says as a
function of what. Its quantities are amplitudes of terms, degree by degree, in tesla (per ampere) at the edge of the readings; keys tell the
degree. A diagnosis gives them priors and asks how high a degree readings support.
"""

from __future__ import annotations

import inspect
import math
import re
import types
from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from jaxtyping import Float

from estimator.effects.base import POSITIVE, Effect, Quantities, Starts, Theta, fixed, normal, vector, written
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.declaring import made
from estimator.tensors import Tensor, torch

KEY = re.compile(r"degree(?P<degree>\d+)_\w+")
TYPICAL_SHARE = 1e-3  # of the largest field, or of the reach: the width until a diagnosis sets it
READINGS_PER_TERM = 3  # of each component: fewer readings would be followed rather than described
FUNCTION = "variable"  # of a target: what the function of a declaration stands for


@dataclass(frozen=True)
class Limit:
    """Highest degree that readings determine; below the lowest where they determine none.

    Attributes:
        words: Why no higher, and what to measure; empty where nothing stands in the way.
    """

    degree: int
    words: str = ""


@dataclass(frozen=True)
class Scale:
    """A number in units of which a correction has its terms, and which a fit leaves as a session has given it.

    Attributes:
        key, unit: As of a quantity.
        most: Largest value in a session like this one.
        here: Value in a session, at a place.
    """

    key: str
    unit: str
    most: Callable[[Extent], float]
    here: Callable[[Circumstances, str], float]


# The largest component that a sensor read, and the largest current of the session.
RANGE_T = Scale(
    "range_T", "T", lambda extent: 2.0 * extent.largest_field_T, Circumstances.largest_of_sensor_T
)
RANGE_A = Scale(
    "range_A", "A", lambda extent: 100.0 * extent.largest_current_A, lambda now, _: now.largest_current_A
)


class Correction(Effect):
    """A smooth field or response. Subclasses say of what, beside one of the stages.

    Attributes:
        components: What each of its functions is of, as names of the terms of every degree.
        scales: What its terms are in units of.
        lowest, highest: Degrees that it may have; beyond the highest it is not smooth.
        asked_from: Lowest degree that a diagnosis asks for, where lower ones are a cause with a name.
        unit: Of its amplitudes.
        falloff: Power of one over the degree by which widths of amplitudes fall; 1 as of a random walk, or of a curve with steps.
        single: Name of the cause that one step alone is.
        is_whole: Whether a diagnosis asks for all its degrees together, and not for the lower ones first.
        counts: What there must be many of for many degrees, in words, and as rows at a place: alike ones count once.
    """

    is_correction = True
    source = "what the causes leave: a diagnosis chooses the width that has most evidence"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    scales: ClassVar[tuple[Scale, ...]] = ()
    lowest: ClassVar[int] = 1
    asked_from: ClassVar[int] = 0
    highest: ClassVar[int] = 5
    unit: ClassVar[str] = "T"
    falloff: ClassVar[float] = 0.0
    single: ClassVar[str | None] = None
    is_whole: ClassVar[bool] = False
    counts: ClassVar[tuple[str, Callable[[Circumstances, str], Tensor]]] = (
        "readings",
        lambda circumstances, _: circumstances.observations.row,
    )

    def terms(self, degree: int) -> tuple[str, ...]:
        """Names of the terms of a degree."""
        return self.components

    def shapes(self, extent: Extent) -> Quantities:
        """What its terms are functions of, in units of what: fixed numbers."""
        return tuple(fixed(s.key, s.unit, 0.0, s.most(extent), POSITIVE) for s in self.scales)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """The scales of this session."""
        return (written({scale.key: scale.here(circumstances, place) for scale in self.scales}),)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """How high a degree the readings determine: by the number of what counts, each with up to three components."""
        what, rows = self.counts
        n, total, highest = len(torch.unique(rows(circumstances, place), dim=0)), 0, self.lowest - 1
        for degree in range(self.lowest, self.highest + 1):
            total += len(self.terms(degree))
            wanted = READINGS_PER_TERM * math.ceil(total / 3)
            if wanted > n:
                return Limit(highest, f"there are {n} {what}; take {wanted} or more")
            highest = degree
        return Limit(highest)

    def factors(
        self, circumstances: Circumstances, place: str, starts: Sequence[dict[str, float]]
    ) -> Float[Tensor, "start reading"] | None:
        """Factor of each reading by which its terms are there, where starts differ in nothing else; the first start has all of them."""
        return None

    def typical_width(self, extent: Extent) -> float:
        """Width of the amplitudes of the first degree until a diagnosis sets it."""
        if self.unit == "1":
            return TYPICAL_SHARE
        if self.unit == "m":
            return TYPICAL_SHARE * extent.reach_m
        per = extent.largest_current_A if self.unit.endswith("/A") else 1.0
        return TYPICAL_SHARE * extent.largest_field_T / per

    def relative_width(self, degree: int) -> float:
        """Width of the amplitudes of a degree over that of the first, which degree 0 has too."""
        return 1.0 if self.falloff == 0.0 else float(max(degree, 1) ** -self.falloff)

    def key(self, degree: int, term: str) -> str:
        """Key of an amplitude; pure numbers have no suffix."""
        suffix = "" if self.unit == "1" else f"_{self.unit.replace('/', '_per_')}"
        return f"degree{degree}_{term}{suffix}"

    def quantities(self, extent: Extent) -> Quantities:
        """Its fixed numbers, then the amplitudes up to the extent's degree."""
        width = self.typical_width(extent)
        amplitudes = (
            normal(self.key(degree, term), self.unit, width * self.relative_width(degree))
            for degree in range(self.lowest, min(extent.degree, self.highest) + 1)
            for term in self.terms(degree)
        )
        return (*self.shapes(extent), *amplitudes)

    def extent_of(self, keys: Iterable[str]) -> Extent:
        """One with the highest degree that they tell of."""
        return Extent(degree=max(_degrees(keys), default=2))

    def amplitudes(self, theta: Theta) -> dict[int, Float[Tensor, "*batch term"]]:
        """Amplitudes by degree."""
        return {
            degree: vector(theta, [self.key(degree, term) for term in self.terms(degree)])[..., 0, :]
            for degree in sorted(_degrees(theta))
        }


class Composed(Correction):
    """A correction of a target, which asks for its value, and a basis, which says what that is."""

    @abstractmethod
    def value(self, variable: Any, theta: Theta) -> Float[Tensor, "*batch reading component"]:
        """Each component as a function of a variable, with an axis for components where these differ in it."""


def _degrees(keys: Iterable[str]) -> set[int]:
    return {int(match["degree"]) for match in map(KEY.fullmatch, keys) if match}


def correction(*parts: type[Effect], **declared: Any) -> Callable[[Callable[..., Any]], Correction]:
    """Make a correction of a target and a basis, of a function that has its name and whose docstring says what it is, as with causes.

    The function is what the basis is a function of; it takes those arguments of the target's `variable` that it needs, by name. One
    without arguments only explains: then it is what target and basis say, such as the time.

    Args:
        *parts: The target, then the basis.
        **declared: Attributes and methods of `Correction` and the parts.
    Raises:
        InvalidInput: The parts have no such attribute or argument.
    """
    both: Any = types.new_class("Correction", parts)

    def joined(function: Callable[..., Any]) -> Correction:
        method = FUNCTION if inspect.signature(function).parameters else None
        return made(both, function, declared, method, both.source)

    return joined


def constant(theta: Theta, key: str) -> Float[Tensor, ""]:
    """A quantity that no fit changes, so that it is alike in a batch."""
    return theta[key].flatten()[0]


def constants(theta: Theta, keys: Iterable[str]) -> Float[Tensor, " key"]:
    """Such quantities as a vector."""
    return torch.stack([constant(theta, key) for key in keys])
