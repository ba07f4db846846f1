"""The contract of a correction: a smooth field or response that physics allows, for what is left where no known cause explains it.

A correction is an effect without a name for what has happened. Its quantities are amplitudes of terms, degree by degree, in tesla (per
ampere) at the edge of the readings; keys tell the degree. A diagnosis gives them priors and asks how high a degree readings support.
"""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import POSITIVE, Effect, Quantities, Starts, Theta, fixed, normal, vector, written
from estimator.effects.circumstances import Circumstances, Extent
from estimator.frames import Transform
from estimator.rig.rig import AnyCoil
from estimator.tensors import Tensor, torch

KEY = re.compile(r"degree(?P<degree>\d+)_\w+")
TYPICAL_SHARE = 1e-3  # of the largest field, or of the reach: the width until a diagnosis sets it
SAME_PLACE = 1e-3  # of the reach: nearer places count once
READINGS_PER_TERM = 3  # of each component: fewer readings would be followed rather than described
THIN = 0.03  # of the widest extent: thinner sets of places are a plane or a line
PLANE_DEGREE = 2  # from a plane: what is off it is extrapolated from slopes across it


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

    def terms(self, degree: int) -> tuple[str, ...]:
        """Names of the terms of a degree."""
        return self.components

    def shapes(self, extent: Extent) -> Quantities:
        """What its terms are functions of, in units of what: fixed numbers."""
        return tuple(fixed(s.key, s.unit, 0.0, s.most(extent), POSITIVE) for s in self.scales)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """The scales of this session."""
        return (written({scale.key: scale.here(circumstances, place) for scale in self.scales}),)

    @abstractmethod
    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """How high a degree the readings determine."""

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
        return (
            *self.shapes(extent),
            *(
                normal(self.key(degree, term), self.unit, width * self.relative_width(degree))
                for degree in range(self.lowest, min(extent.degree, self.highest) + 1)
                for term in self.terms(degree)
            ),
        )

    def extent_of(self, keys: Iterable[str]) -> Extent:
        """One with the highest degree that they tell of."""
        return Extent(degree=max((int(m["degree"]) for m in map(KEY.fullmatch, keys) if m), default=2))

    def amplitudes(self, theta: Theta) -> dict[int, Float[Tensor, "*batch term"]]:
        """Amplitudes by degree."""
        degrees = sorted({int(match["degree"]) for match in map(KEY.fullmatch, theta) if match})
        return {
            degree: vector(theta, [self.key(degree, term) for term in self.terms(degree)])[..., 0, :]
            for degree in degrees
        }


def positions_m(circumstances: Circumstances, coil: AnyCoil | None = None) -> Float[Tensor, "reading 3"]:
    """Nominal position of the sensor at each reading, in the frame of a coil or in the room."""
    n = len(circumstances)
    each = [
        circumstances.world_from(sensor).translation_m.expand(n, 3) for sensor in circumstances.rig.sensors
    ]
    world_m = torch.stack(each)[circumstances.sensor, torch.arange(n, device=circumstances.sensor.device)]
    if coil is None:
        return world_m
    world_from_coil = circumstances.world_from(coil)
    turns = Transform(world_from_coil.rotation.expand(n, 3, 3), world_from_coil.translation_m.expand(n, 3))
    return turns.inverse().apply(world_m)


def limit_of_places(places_m: Float[Tensor, "reading 3"], n_terms: dict[int, int]) -> Limit:
    """How high a degree of a field the places determine at which it was read.

    Args:
        places_m: Of all readings, in the frame of the field.
        n_terms: By degree, the number of terms up to it.
    """
    lowest, highest = min(n_terms), max(n_terms)
    middle_m = places_m.mean(0)
    reach_m = float((places_m - middle_m).norm(dim=-1).max())
    if reach_m == 0.0:
        return Limit(lowest - 1, "all readings are at one place; move the sensor")
    places = torch.unique(((places_m - middle_m) / (SAME_PLACE * reach_m)).round(), dim=0)
    spread = torch.linalg.svdvals(places - places.mean(0))
    n_wide = int((spread > THIN * spread[0]).sum())
    if n_wide == 1:
        return Limit(lowest - 1, "all readings lie on one line; measure beside it, on both sides")
    enough = [degree for degree, n in n_terms.items() if n <= len(places)]
    if not enough:
        return Limit(
            lowest - 1, f"readings are at {len(places)} places; measure at {n_terms[lowest]} or more"
        )
    if n_wide == 2 and max(enough) > PLANE_DEGREE:
        return Limit(PLANE_DEGREE, "all readings lie in one plane; measure off it, on both sides")
    if max(enough) < highest:
        wanted = n_terms[max(enough) + 1]
        return Limit(max(enough), f"readings are at {len(places)} places; measure at {wanted} or more")
    return Limit(highest)


def limit_of_number(correction: Correction, n: int, what: str) -> Limit:
    """How high a degree a number of readings determines, each with up to three components.

    Args:
        correction: Says how many terms it has.
        n, what: How many there are, and of what.
    """
    n_terms, total = {}, 0
    for degree in range(correction.lowest, correction.highest + 1):
        total += len(correction.terms(degree))
        n_terms[degree] = math.ceil(total / 3)
    enough = [degree for degree, terms in n_terms.items() if READINGS_PER_TERM * terms <= n]
    highest = max(enough, default=correction.lowest - 1)
    if highest == correction.highest:
        return Limit(highest)
    return Limit(highest, f"there are {n} {what}; take {READINGS_PER_TERM * n_terms[highest + 1]} or more")
