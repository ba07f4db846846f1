"""Sensors that respond otherwise in a part: after an exchange, on one side of a way, segment by segment, at the end of the range."""

from __future__ import annotations

from typing import Any

from estimator.effects.base import Quantities, Starts, Theta, at_most, fixed, pure, triple
from estimator.effects.causes.sensor import axis_gain, cross_axis, sensor_offset
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.during import during, instants_within
from estimator.effects.segments import each_segment, in_each_segment, is_several, of_segment, segments_of
from estimator.effects.stages import Components, ReadingEffect
from estimator.tensors import torch

CLIPPED_AT = (0.999, 0.99, 0.98, 0.97, 0.95, 0.92, 0.88, 0.82, 0.75, 0.65, 0.5)
LEAST_SHARE = 0.2  # of a sensor's readings that each of two exchanged sensors has
CUTS = 6  # parts of the readings, between which a side may begin
LEAST_WAY = 1e-3  # of the longest: along shorter ways there are no sides


def _in_turn(*parts: ReadingEffect) -> ReadingEffect:
    """Effects of a sensor as one, in the order in which they act."""

    @ReadingEffect.cause(
        words=" and ".join(part.words for part in parts),
        source="; ".join(part.source for part in parts),
        quantities=lambda extent: tuple(each for part in parts for each in part.quantities(extent)),
    )
    def together(
        field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """One after the other."""
        for part in parts:
            field_sensor_T = part.apply(field_sensor_T, theta, circumstances, sensor)
        return field_sensor_T

    return together


@during(
    _in_turn(cross_axis, axis_gain, sensor_offset),
    # Enough readings of either sensor to tell its constants: fewer readings follow any twelve numbers.
    starts=lambda circumstances, place: instants_within(circumstances, place, LEAST_SHARE),
)
def sensor_exchanged() -> None:
    """From one instant on another sensor reads, with gains and a zero of its own.

    From one instant on another sensor hangs on the same cable, with gains, mixings and a zero of its own.

    Source: sensors of one make differ as axis_gain, cross_axis and sensor_offset say.
    """


_CONTACT = _in_turn(axis_gain, sensor_offset)


def _contact(extent: Extent) -> Quantities:
    """Gains and zero beyond a place; the axis of the mover (0 x, 1 y, 2 z), the place along it, and the side (1 above, -1 below)."""
    ends_m = 100.0 * extent.reach_m
    sides = (
        fixed("along", "1", 0.0, 2.0),
        fixed("beyond_m", "m", -ends_m, ends_m),
        fixed("side", "1", -1.0, 1.0),
    )
    return (*_CONTACT.quantities(extent), *sides)


def _sides(circumstances: Circumstances, place: str) -> Starts:
    """Either side of places that part the sensor's own readings evenly, along each axis along which the mover went between them."""
    at_m = circumstances.mover_of_sensor_m(place)
    assert at_m is not None  # see `concerns`
    at_m = at_m[circumstances.is_of(place)]
    way_m = at_m.max(0).values - at_m.min(0).values
    starts = []
    for axis in range(3):
        ordered_m = at_m[:, axis].sort().values
        if float(way_m[axis]) <= LEAST_WAY * float(way_m.max()):
            continue
        parts = ordered_m[torch.arange(1, CUTS, device=ordered_m.device) * len(ordered_m) // CUTS]
        places_m = ordered_m.unique()
        above = torch.searchsorted(places_m, parts).clamp(min=1).unique()
        for beyond_m in (0.5 * (places_m[above - 1] + places_m[above])).tolist():
            starts += [{"along": float(axis), "beyond_m": beyond_m, "side": side} for side in (1.0, -1.0)]
    return tuple(starts)


@ReadingEffect.cause(
    quantities=_contact,
    # Readings all on one side would have another gain and another zero.
    concerns=lambda circumstances, place: circumstances.moved_between(place),
    starts=_sides,
)
def sensor_contact(
    field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
) -> Components:
    """On one side of the mover's way the sensor has other gains and another zero.

    The sensor has other gains and another zero where the mover stands beyond some place along one axis: a cable pulls at its contact.

    The mover is that of the sensor, or of the first coil that has one where the sensor stands still.

    Source: a worn cable or plug: per mille to per cents of a gain, and zeros as sensor_offset says.
    """
    at_m = circumstances.mover_of_sensor_m(sensor)
    if at_m is None:
        return field_sensor_T
    changed_T = _CONTACT.apply(field_sensor_T, theta, circumstances, sensor)
    along_m = at_m.T[theta["along"].long()]
    is_there = theta["side"][..., None] * (along_m - theta["beyond_m"][..., None]) > 0.0
    return torch.where(is_there[..., None], changed_T, field_sensor_T)


def _in_segments(quantities: Quantities) -> dict[str, Any]:
    """What a sensor declares that has these quantities in every segment."""

    def was_read_in_several(circumstances: Circumstances, place: str) -> bool:
        return is_several(circumstances.segments_of(place))

    def not_read(circumstances: Circumstances, place: str) -> frozenset[str]:
        """Quantities of segments in which the sensor was not read."""
        read = set(circumstances.segments_of(place))
        keys = [quantity.key for quantity in in_each_segment(circumstances.extent, quantities)]
        return frozenset(key for key in keys if not set(segments_of([key])) <= read)

    return each_segment(quantities) | {"concerns": was_read_in_several, "unseen": not_read}


@ReadingEffect.cause(**_in_segments(pure(gain=0.01)))
def segment_gain(field_sensor_T: Components, theta: Theta, circumstances: Circumstances) -> Components:
    """In each segment of the session the sensor has another gain.

    The sensor has another gain in each segment: another range, excitation or day.

    Source: ranges and excitation currents of Hall teslameters agree to 0.1 to 1 %.
    """
    return field_sensor_T * (1.0 + of_segment(theta, ("gain",), circumstances.segment))


@ReadingEffect.cause(**_in_segments(triple("xyz", "_T", "T", 50e-6)))
def segment_zero(field_sensor_T: Components, theta: Theta, circumstances: Circumstances) -> Components:
    """In each segment of the session the sensor has another zero offset.

    The sensor was zeroed anew before each segment.

    Source: zeroing in a chamber or in the field of the room leaves as much as sensor_offset says.
    """
    return field_sensor_T + of_segment(theta, ("x_T", "y_T", "z_T"), circumstances.segment)


def _inside_the_largest(circumstances: Circumstances, place: str) -> Starts:
    """Just inside the sensor's largest reading, where a limit gathers readings."""
    largest_T = circumstances.largest_of_sensor_T(place)
    return tuple({"limit_T": share * largest_T} for share in CLIPPED_AT)


@ReadingEffect.cause(
    quantities=lambda extent: (at_most("limit_T", "T", 0.2, 3.0, extent.largest_field_T),),
    starts=_inside_the_largest,
)
def range_clipping(field_sensor_T: Components, theta: Theta) -> Components:
    """Components beyond the sensor's range are cut off.

    Components beyond the range read as its end.

    Source: any range; the readings show where it ends.
    """
    limit = theta["limit_T"][..., None, None]
    return torch.minimum(torch.maximum(field_sensor_T, -limit), limit)
