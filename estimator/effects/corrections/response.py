"""Corrections of what a sensor says, as functions of what it shows, of where the mover stands, and of the currents."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from itertools import combinations_with_replacement

from jaxtyping import Float

from estimator.effects.base import Quantities, Starts, Theta, fixed, shape, switch
from estimator.effects.circumstances import LEAST_STEP, Circumstances, Extent
from estimator.effects.corrections.correction import RANGE_A, RANGE_T, Correction, Limit, limit_of_number
from estimator.effects.corrections.in_time import MOST_HALF_CYCLES, Periodic
from estimator.effects.corrections.way import AlongWay
from estimator.effects.stages import Components, ReadingEffect
from estimator.tensors import Tensor, torch

MOST_LEVELS = 100  # of each axis
FEWEST_BEYOND = 3  # readings on either side of a level


class OfShown(Correction, ReadingEffect):
    """A function of what the sensor shows."""

    @abstractmethod
    def added_T(self, shown_T: Components, theta: Theta) -> Components:
        """What it adds to what the sensor would show."""

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different readings of the sensor determines."""
        n_different = len(torch.unique(_shown_T(circumstances, place), dim=0))
        return limit_of_number(self, n_different, "different readings")

    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """Components as they are read."""
        return field_sensor_T + self.added_T(field_sensor_T, theta)


class OverRange(OfShown):
    """A function of what the sensor shows, in units of its largest component."""

    scales = (RANGE_T,)

    def curve(self, way: Tensor, theta: Theta) -> Tensor:
        """Sum of half waves times their amplitudes, component by component.

        Args:
            way: Share of the range, with an axis for components.
            theta: Quantities.
        """
        waves = (
            amplitude[..., None, :] * torch.cos(math.pi * degree * way)
            for degree, amplitude in self.amplitudes(theta).items()
        )
        return sum(waves, start=way.new_zeros(()))


class SensorResponse(OverRange):
    """Each component that the sensor shows bends with all three."""

    name = "sensor_response"
    words = "a smooth response of the sensor in the three components that it shows"
    lowest = 0
    asked_from = 1  # a constant is `sensor_offset`
    highest = 3

    def terms(self, degree: int) -> tuple[str, ...]:
        """For each component, the products of components: `x_yy` adds the square of y to x; `x` alone a constant."""
        products = ["".join(axes) for axes in combinations_with_replacement("xyz", degree)]
        return tuple(f"{axis}_{product}".rstrip("_") for axis in "xyz" for product in products)

    def added_T(self, shown_T: Components, theta: Theta) -> Components:
        """Polynomials of the components."""
        parts = dict(zip("xyz", (shown_T / theta["range_T"].flatten()[0]).unbind(-1), strict=True))
        total = shown_T.new_zeros(())
        for degree, amplitude in self.amplitudes(theta).items():
            products = [
                math.prod((parts[axis] for axis in axes), start=torch.ones_like(parts["x"]))
                for axes in combinations_with_replacement("xyz", degree)
            ]
            by_component = amplitude.unflatten(-1, (3, len(products)))
            total = total + torch.stack(products, dim=-1) @ by_component.mT
        return total


class ResponseByPlace(AlongWay, ReadingEffect):
    """Zero and gain of each axis follow cosines of half waves over the way that the mover went along each of its axes.

    The mover is that of the sensor, or of the first coil that has one where the sensor stands still.
    """

    name = "response_by_place"
    words = "zero and gains of the sensor depend on where the mover stands"
    # Zero (`x_along_y`) and gain (`gain_x_along_y`) of which axis, along which way.
    components = tuple(
        f"{kind}{axis}_along_{way}" for kind in ("", "gain_") for way in "xyz" for axis in "xyz"
    )
    highest = 8
    falloff = 1.0
    scales = (RANGE_T,)

    def shapes(self, extent: Extent) -> Quantities:
        """The field in units of which gains are told, where the way along each axis begins, and how long it is."""
        begin, length = self.ends(extent)
        return (*Correction.shapes(self, extent), *begin, *length)

    def at_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Reported positions of the mover, in m."""
        at_m = circumstances.mover_of_sensor_m(place)
        assert at_m is not None  # see `concerns`
        return at_m

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether a mover moved from one reading of the sensor to another."""
        return circumstances.moved_between(place)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different positions of the mover at the sensor's own readings determines."""
        own_m = self.at_m(circumstances, place)[circumstances.is_of(place)]
        n_places = len(torch.unique((1e6 * own_m).round(), dim=0))
        return limit_of_number(self, n_places, "different places")

    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """Components as they are read."""
        way = self.way(self.at_m(circumstances, sensor), theta)
        share = field_sensor_T / theta["range_T"].flatten()[0]
        for degree, amplitude in self.amplitudes(theta).items():
            zero, gain = amplitude.unflatten(-1, (2, 3, 3)).unbind(-3)  # way, axis
            waves = torch.cos(math.pi * degree * way)
            field_sensor_T = field_sensor_T + waves @ zero + share * (waves @ gain)
        return field_sensor_T


class AxisCurves(OverRange):
    """Each axis of a sensor has a curve of its own: cosines of half waves over its range, as of steps and bends of a converter."""

    name = "axis_curves"
    words = "each axis of the sensor errs as a function of what it shows"
    highest = 16
    falloff = 1.0

    def added_T(self, shown_T: Components, theta: Theta) -> Components:
        """The curve of each component."""
        return self.curve(0.5 * (shown_T / theta["range_T"].flatten()[0] + 1.0), theta)


class GainCurve(OverRange):
    """The gain of a sensor depends on the largest of its components, as where an instrument changes its range: cosines of half waves."""

    name = "gain_curve"
    words = "the gain of the sensor depends on how strong its largest component is"
    unit = "1"
    components = ("share",)  # of all axes
    highest = 16
    falloff = 1.0

    def added_T(self, shown_T: Components, theta: Theta) -> Components:
        """A share of all components, by the largest of them."""
        largest_T = shown_T.abs().amax(-1, keepdim=True)
        return shown_T * self.curve(largest_T / theta["range_T"].flatten()[0], theta)


class AboveLevel(OfShown):
    """One step at one level. It would be many half waves over the range, which swing where nothing was read."""

    highest = 1

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the sensor was read at several levels."""
        return len(self.starts(circumstances, place)) > 1


class AxisSteps(AboveLevel):
    """One axis of a sensor reads more by a step wherever its component exceeds a level, as where codes are missing."""

    name = "axis_steps"
    words = "one axis of the sensor is off by a step above some level"
    components = ("step",)

    def shapes(self, extent: Extent) -> Quantities:
        """Number of the axis, and the level."""
        ends_T = 2.0 * extent.largest_field_T
        return (switch("axis", 0.0, 2.0, 0.0), fixed("above_T", "T", -ends_T, ends_T))

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """Between any two readings of each axis."""
        by_axis = enumerate(_shown_T(circumstances, place).T)
        return tuple(
            {"axis": float(axis), "above_T": at_T} for axis, own_T in by_axis for at_T in _levels(own_T)
        )

    def added_T(self, shown_T: Components, theta: Theta) -> Components:
        """The step, above the level of the axis."""
        is_axis = torch.arange(3, device=shown_T.device) == theta["axis"][..., None, None]
        is_above = (shown_T > theta["above_T"][..., None, None]) & is_axis
        return self.amplitudes(theta)[1][..., None, :] * is_above


class GainSteps(AboveLevel):
    """The gain of a sensor is another one where its largest component exceeds a level, as where an instrument changes its range."""

    name = "gain_steps"
    words = "the gain of the sensor is another one above some level"
    unit = "1"
    components = ("share",)  # of all axes

    def shapes(self, extent: Extent) -> Quantities:
        """Level above which the share holds, in T."""
        return (fixed("above_T", "T", 0.0, 2.0 * extent.largest_field_T),)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """Level 0, under all readings, then levels between any two readings."""
        largest_T = _shown_T(circumstances, place).abs().amax(-1)
        return tuple({"above_T": level_T} for level_T in (0.0, *_levels(largest_T)))

    def factors(
        self, circumstances: Circumstances, place: str, starts: Sequence[dict[str, float]]
    ) -> Float[Tensor, "start reading"]:
        """For each level 1 at readings above it, else 0."""
        shown_T = circumstances.observations.field_sensor_T.abs().amax(-1)
        levels_T = shown_T.new_tensor([start["above_T"] for start in starts])
        return (shown_T > levels_T[:, None]).to(circumstances.hours)

    def added_T(self, shown_T: Components, theta: Theta) -> Components:
        """A share of all components above the level."""
        is_above = shown_T.abs().amax(-1) > theta["above_T"][..., None]
        return shown_T * (self.amplitudes(theta)[1] * is_above)[..., None]


class CurrentPickup(Correction, ReadingEffect):
    """A sensor shows something of the coils' currents themselves, as over a common return wire: powers of their sum."""

    name = "current_pickup"
    words = "the sensor shows something of the currents themselves"
    scales = (RANGE_A,)
    highest = 3

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different currents besides 0 determines, of those while the sensor was read."""
        total_A = circumstances.current_A[circumstances.is_of(place)].sum(-1)
        least_A = LEAST_STEP * circumstances.largest_current_A
        n = len(torch.unique((total_A[total_A != 0.0] / least_A).round()))
        if n >= self.highest:
            return Limit(self.highest)
        return Limit(n, f"there are {n} currents besides 0; measure at {self.highest} or more")

    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """Components as they are read."""
        share = circumstances.current_A.sum(-1) / theta["range_A"].flatten()[0]
        for degree, amplitude in self.amplitudes(theta).items():
            field_sensor_T = field_sensor_T + amplitude[..., None, :] * share[:, None] ** degree
        return field_sensor_T


class ReadingRipples(OfShown, Periodic):
    """Errors of a sensor's converter repeat over its range: each component is off by a wave of its own value."""

    name = "reading_ripples"
    words = "errors of the sensor repeat over its range"

    def shapes(self, extent: Extent) -> Quantities:
        """The frequency, in cycles per tesla."""
        most_per_T = 1e3 * MOST_HALF_CYCLES * _half_a_cycle_per_T(extent.largest_field_T)
        return (shape("frequency_per_T", "1/T", 0.0, most_per_T),)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """Frequencies half a cycle over the range apart, as many as there are readings at most."""
        spacing = _half_a_cycle_per_T(circumstances.largest_of_sensor_T(place))
        n = min(len(torch.unique(_shown_T(circumstances, place), dim=0)), MOST_HALF_CYCLES)
        return tuple({"frequency_per_T": (i + 1) * spacing} for i in range(n))

    def added_T(self, shown_T: Components, theta: Theta) -> Components:
        """A wave of each component's own value."""
        return self.swing(theta, shown_T * theta["frequency_per_T"][..., None, None])


def _shown_T(circumstances: Circumstances, sensor: str) -> Float[Tensor, "own 3"]:
    """What one sensor read."""
    return circumstances.observations.field_sensor_T[circumstances.is_of(sensor)]


def _half_a_cycle_per_T(largest_T: float) -> float:
    """Frequency of half a cycle from minus to plus the largest component, in cycles per tesla."""
    return 0.25 / largest_T


def _levels(shown_T: Float[Tensor, " reading"]) -> list[float]:
    """Levels in the middle between two readings, with some readings on either side."""
    ordered_T = shown_T[~torch.isnan(shown_T)].unique()
    between_T = (0.5 * (ordered_T[1:] + ordered_T[:-1]))[FEWEST_BEYOND - 1 : 1 - FEWEST_BEYOND]
    if not len(between_T):
        return []
    rows = torch.linspace(0, len(between_T) - 1, min(MOST_LEVELS, len(between_T)), device=between_T.device)
    rows = rows.round().long().unique()
    levels_T: list[float] = between_T[rows].tolist()
    return levels_T
