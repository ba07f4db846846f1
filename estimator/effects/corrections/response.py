"""Corrections of what a sensor says, as functions of what it shows, of where the mover stands, and of the currents."""

from __future__ import annotations

import math
from itertools import combinations_with_replacement

from jaxtyping import Float

from estimator.effects.base import POSITIVE, Quantities, Starts, Theta, fixed, shape, switch
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.bases import (
    MOST_HALF_CYCLES,
    AboveLevel,
    AlongWay,
    Periodic,
    Table,
    Waves,
    ends_of_ways,
)
from estimator.effects.corrections.correction import RANGE_A, RANGE_T, Composed, Limit, constant, correction
from estimator.effects.corrections.targets import Gain, Zero, ZeroAndGain
from estimator.effects.history import LEAST_STEP
from estimator.effects.stages import Components
from estimator.tensors import Tensor, torch

MOST_LEVELS = 100  # of each axis
FEWEST_BEYOND = 3  # readings on either side of a level
MOST_POWERS = 3  # of the currents


def _shown_T(circumstances: Circumstances, sensor: str) -> Float[Tensor, "own 3"]:
    """What one sensor read."""
    return circumstances.observations.field_sensor_T[circumstances.is_of(sensor)]


DIFFERENT = ("different readings", _shown_T)


class Products(Composed):
    """Products of components: `x_yy` adds the square of y to x; `x` alone a constant."""

    def terms(self, degree: int) -> tuple[str, ...]:
        """For each component, the products of components."""
        products = ["".join(axes) for axes in combinations_with_replacement("xyz", degree)]
        return tuple(f"{axis}_{product}".rstrip("_") for axis in "xyz" for product in products)

    def value(self, share: Components, theta: Theta) -> Components:
        """Polynomials of the components."""
        parts = dict(zip("xyz", share.unbind(-1), strict=True))
        total = share.new_zeros(())
        for degree, amplitude in self.amplitudes(theta).items():
            products = [
                math.prod((parts[axis] for axis in axes), start=torch.ones_like(parts["x"]))
                for axes in combinations_with_replacement("xyz", degree)
            ]
            by_component = amplitude.unflatten(-1, (3, len(products)))
            total = total + torch.stack(products, dim=-1) @ by_component.mT
        return total


@correction(
    Zero,
    Products,
    lowest=0,
    asked_from=1,  # a constant is `sensor_offset`
    highest=3,
    scales=(RANGE_T,),
    counts=DIFFERENT,
)
def sensor_response(field_sensor_T: Components, theta: Theta) -> Components:
    """A smooth response of the sensor in the three components that it shows.

    Each component that the sensor shows bends with all three.
    """
    return field_sensor_T / constant(theta, "range_T")


def _mover_m(circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
    """Reported positions of the mover of a sensor, in m."""
    at_m = circumstances.mover_of_sensor_m(place)
    assert at_m is not None  # see `concerns`
    return at_m


def _range_and_ways(extent: Extent) -> Quantities:
    """The field in units of which gains are told, where the way along each axis begins, and how long it is."""
    begin, length = ends_of_ways(extent)
    return (fixed(RANGE_T.key, RANGE_T.unit, 0.0, RANGE_T.most(extent), POSITIVE), *begin, *length)


@correction(
    ZeroAndGain,
    AlongWay,
    terms=tuple(f"{kind}{axis}_along_{way}" for kind in ("", "gain_") for way in "xyz" for axis in "xyz"),
    highest=8,
    falloff=1.0,
    shapes=_range_and_ways,
    at_m=_mover_m,
    concerns=lambda circumstances, place: circumstances.moved_between(place),
    counts=("different places", lambda now, place: (1e6 * _mover_m(now, place)[now.is_of(place)]).round()),
)
def response_by_place(circumstances: Circumstances, sensor: str) -> Tensor:
    """Zero and gains of the sensor depend on where the mover stands.

    Zero and gain of each axis follow cosines of half waves over the way that the mover went along each of its axes.

    The mover is that of the sensor, or of the first coil that has one where the sensor stands still.
    """
    return _mover_m(circumstances, sensor)


@correction(Zero, Waves, scales=(RANGE_T,), counts=DIFFERENT)
def axis_curves(field_sensor_T: Components, theta: Theta) -> Components:
    """Each axis of the sensor errs as a function of what it shows.

    Each axis of a sensor has a curve of its own: cosines of half waves over its range, as of steps and bends of a converter.
    """
    return 0.5 * (field_sensor_T / constant(theta, "range_T") + 1.0)


@correction(Gain, Waves, scales=(RANGE_T,), counts=DIFFERENT)
def gain_curve(field_sensor_T: Components, theta: Theta) -> Tensor:
    """The gain of the sensor depends on how strong its largest component is.

    The gain of a sensor depends on the largest of its components, as where an instrument changes its range: cosines of half waves.
    """
    return field_sensor_T.abs().amax(-1, keepdim=True) / constant(theta, "range_T")


def _levels(shown_T: Float[Tensor, " reading"]) -> list[float]:
    """Levels in the middle between two readings, with some readings on either side."""
    ordered_T = shown_T[~torch.isnan(shown_T)].unique()
    between_T = (0.5 * (ordered_T[1:] + ordered_T[:-1]))[FEWEST_BEYOND - 1 : 1 - FEWEST_BEYOND]
    if not len(between_T):
        return []
    rows = torch.linspace(0, len(between_T) - 1, min(MOST_LEVELS, len(between_T)), device=between_T.device)
    return between_T[rows.round().long().unique()].tolist()


def _axis_and_level(extent: Extent) -> Quantities:
    """Number of the axis, and the level."""
    ends_T = 2.0 * extent.largest_field_T
    return (switch("axis", 0.0, 2.0, 0.0), fixed("above_T", "T", -ends_T, ends_T))


def _levels_of_axes(circumstances: Circumstances, place: str) -> Starts:
    """Between any two readings of each axis."""
    by_axis = enumerate(_shown_T(circumstances, place).T)
    return tuple({"axis": float(axis), "above_T": at_T} for axis, own_T in by_axis for at_T in _levels(own_T))


@correction(
    Zero, AboveLevel, components=("step",), shapes=_axis_and_level, starts=_levels_of_axes, counts=DIFFERENT
)
def axis_steps(field_sensor_T: Components, theta: Theta) -> Components:
    """One axis of the sensor is off by a step above some level.

    One axis of a sensor reads more by a step wherever its component exceeds a level, as where codes are missing.
    """
    is_axis = torch.arange(3, device=field_sensor_T.device) == theta["axis"][..., None, None]
    return torch.where(is_axis, field_sensor_T, -torch.inf)


def _levels_of_largest(circumstances: Circumstances, place: str) -> Starts:
    """Level 0, under all readings, then levels between any two readings."""
    largest_T = _shown_T(circumstances, place).abs().amax(-1)
    return tuple({"above_T": level_T} for level_T in (0.0, *_levels(largest_T)))


@correction(
    Gain,
    AboveLevel,
    shapes=lambda extent: (fixed("above_T", "T", 0.0, 2.0 * extent.largest_field_T),),
    starts=_levels_of_largest,
    counts=DIFFERENT,
)
def gain_steps(field_sensor_T: Components) -> Tensor:
    """The gain of the sensor is another one above some level.

    The gain of a sensor is another one where its largest component exceeds a level, as where an instrument changes its range.
    """
    return field_sensor_T.abs().amax(-1, keepdim=True)


def _by_currents(circumstances: Circumstances, place: str) -> Limit:
    """Highest degree that the number of different currents besides 0 determines, of those while the sensor was read."""
    total_A = circumstances.current_A[circumstances.is_of(place)].sum(-1)
    least_A = LEAST_STEP * circumstances.largest_current_A
    n = len(torch.unique((total_A[total_A != 0.0] / least_A).round()))
    if n >= MOST_POWERS:
        return Limit(MOST_POWERS)
    return Limit(n, f"there are {n} currents besides 0; measure at {MOST_POWERS} or more")


@correction(Zero, Table, scales=(RANGE_A,), highest=MOST_POWERS, limit=_by_currents)
def current_pickup(theta: Theta, circumstances: Circumstances) -> dict[int, Tensor]:
    """The sensor shows something of the currents themselves.

    A sensor shows something of the coils' currents themselves, as over a common return wire: powers of their sum.
    """
    share = circumstances.current_A.sum(-1, keepdim=True) / constant(theta, "range_A")
    return {degree: share**degree for degree in range(1, MOST_POWERS + 1)}


def _half_a_cycle_per_T(largest_T: float) -> float:
    """Frequency of half a cycle from minus to plus the largest component, in cycles per tesla."""
    return 0.25 / largest_T


def _frequencies(circumstances: Circumstances, place: str) -> Starts:
    """Frequencies half a cycle over the range apart, as many as there are readings at most."""
    spacing = _half_a_cycle_per_T(circumstances.largest_of_sensor_T(place))
    n = min(len(torch.unique(_shown_T(circumstances, place), dim=0)), MOST_HALF_CYCLES)
    return tuple({"frequency_per_T": (i + 1) * spacing} for i in range(n))


def _frequency(extent: Extent) -> Quantities:
    """The frequency, in cycles per tesla."""
    most_per_T = 1e3 * MOST_HALF_CYCLES * _half_a_cycle_per_T(extent.largest_field_T)
    return (shape("frequency_per_T", "1/T", 0.0, most_per_T),)


@correction(Zero, Periodic, shapes=_frequency, starts=_frequencies, counts=DIFFERENT)
def reading_ripples(field_sensor_T: Components, theta: Theta) -> Components:
    """Errors of the sensor repeat over its range.

    Errors of a sensor's converter repeat over its range: each component is off by a wave of its own value.
    """
    return field_sensor_T * theta["frequency_per_T"][..., None, None]
