"""What a three-axis Hall sensor says instead of the field: its response and its zero, in part of a session or all of it."""

from __future__ import annotations

from itertools import permutations
from typing import Any

from estimator.effects.base import (
    Quantities,
    Quantity,
    Starts,
    Theta,
    at_most,
    fixed,
    normal,
    triple,
    vector,
)
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.during import during, instants_within, spell, spells_of
from estimator.effects.segments import each_segment, in_each_segment, is_several, of_segment, segments_of
from estimator.effects.stages import Components, Current, ReadingEffect
from estimator.rig.parameters import LogNormal
from estimator.tensors import torch

CLIPPED_AT = (0.999, 0.99, 0.98, 0.97, 0.95, 0.92, 0.88, 0.82, 0.75, 0.65, 0.5)
# xy: what the x axis picks up of the y component.
PAIRS = tuple("".join(pair) for pair in permutations("xyz", 2))
LEAST_SHARE = 0.2  # of a sensor's readings that each of two exchanged sensors has
CUTS = 6  # parts of the readings, between which a side may begin
LEAST_WAY = 1e-3  # of the longest: along shorter ways there are no sides


@ReadingEffect.cause(
    words="the sensor's axes pick up each other's components",
    source="elements are mounted to 0.2 to 1 degree; cross sensitivity up to 1 %",
    quantities=triple(PAIRS, "", "1", 0.01),
)
def cross_axis(field_sensor_T: Components, theta: Theta) -> Components:
    """Each axis picks up a share of the other components."""
    zero = torch.zeros_like(theta["xy"])
    rows = [[theta[a + b] if a != b else zero for b in "xyz"] for a in "xyz"]
    mix = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
    return field_sensor_T + (mix[..., None, :, :] @ field_sensor_T[..., None])[..., 0]


@ReadingEffect.cause(
    words="the sensor's axes have wrong gains",
    source="Hall teslameters are specified to 0.1 to 1 % (Metrolab THM1176: 1 %)",
    quantities=triple("xyz", "", "1", 0.01),
)
def axis_gain(field_sensor_T: Components, theta: Theta) -> Components:
    """Each axis has a gain of its own."""
    return field_sensor_T * (1.0 + vector(theta, "xyz"))


@during(
    axis_gain,
    words="for a while the sensor's axes have other gains",
    source="ranges of one amplifier agree to 0.1 to 2 %",
    ends=True,
    starts=lambda circumstances, place: spells_of(circumstances, place, has_ends=True),
)
def gain_spell() -> None:
    """For a while the sensor's axes have other gains: another range, or numbers in another unit.

    No cause says that gains alone change and stay, so a spell may begin with the session or last until after it.
    """


@ReadingEffect.cause(
    words="the sensor's response bends with the field",
    source="linearity of Hall sensors, 0.1 to 1 % of range",
    quantities=lambda extent: triple("xyz", "_per_T2", "1/T2", 0.01 / extent.largest_field_T**2),
)
def cubic_response(field_sensor_T: Components, theta: Theta) -> Components:
    """The response bends: a relative error that grows with the square of the component."""
    return field_sensor_T + vector(theta, "xyz", "_per_T2") * field_sensor_T**3


@ReadingEffect.cause(
    words="each axis adds the product of the two other components",
    source="planar Hall voltage of silicon elements, up to 1 % of the field",
    quantities=lambda extent: triple("xyz", "_per_T", "1/T", 0.01 / extent.largest_field_T),
)
def planar_hall(field_sensor_T: Components, theta: Theta) -> Components:
    """The planar Hall effect: each axis adds the product of the two components in its plane."""
    x, y, z = field_sensor_T.unbind(-1)
    product = torch.stack((y * z, z * x, x * y), dim=-1)
    return field_sensor_T + vector(theta, "xyz", "_per_T") * product


PER_KELVIN = (normal("gain_per_K", "1/K", 1e-3), *triple("xyz", "_T_per_K", "T/K", 5e-6))


def _has_warmed(circumstances: Circumstances, place: str) -> bool:
    """Whether the sensor's thermometer showed a change."""
    kelvin = circumstances.temperature_K(place)
    return kelvin is not None and bool(kelvin.abs().max() > 0.0)


def _at_temperature(field_sensor_T: Components, theta: Theta, kelvin: Current | None) -> Components:
    """Components as a sensor reads them at a temperature of its own, by its gain and zero per kelvin; unchanged without a thermometer."""
    if kelvin is None:
        return field_sensor_T
    gain = theta["gain_per_K"][..., None, None]
    zero = vector(theta, "xyz", "_T_per_K")
    return field_sensor_T * (1.0 + gain * kelvin[..., None]) + zero * kelvin[..., None]


@ReadingEffect.cause(
    words="the sensor's gain and zero follow its temperature",
    source="temperature coefficients of Hall sensors: 100 to 1000 ppm/K, 1 to 10 uT/K",
    quantities=PER_KELVIN,
    concerns=_has_warmed,
)
def temperature_drift(
    field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
) -> Components:
    """Gain and zero of the sensor follow its temperature."""
    return _at_temperature(field_sensor_T, theta, circumstances.temperature_K(sensor))


@ReadingEffect.cause(
    words="the sensor's gain and zero follow its thermometer late",
    source="coefficients as of temperature_drift; a probe in its holder follows the air in 5 minutes to an hour",
    quantities=(*PER_KELVIN, Quantity("tau_h", "h", LogNormal(0.3, 1.0), 0.3, is_shape=True)),
    starts=({"tau_h": 0.1}, {"tau_h": 0.3}, {"tau_h": 1.0}),  # a small probe, one in a holder, a heavy one
    concerns=_has_warmed,
    depends_on="the temperatures before",
)
def thermal_lag(
    field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
) -> Components:
    """Gain and zero of the sensor follow a temperature that lags behind its thermometer."""
    return _at_temperature(field_sensor_T, theta, circumstances.lagged_K(sensor, theta["tau_h"]))


@ReadingEffect.cause(
    words="the sensor shows a constant in no field",
    source="zero errors of Hall sensors, 10 to 100 uT",
    quantities=triple("xyz", "_T", "T", 50e-6),
    is_everywhere=True,
)
def sensor_offset(field_sensor_T: Components, theta: Theta) -> Components:
    """The sensor shows a constant in no field."""
    return field_sensor_T + vector(theta, "xyz", "_T")


@ReadingEffect.cause(
    words="the zero of the sensor drifts",
    source="some 10 uT while electronics warm up",
    # Change per hour from the beginning of the session on.
    quantities=lambda extent: triple("xyz", "_T_per_h", "T/h", 50e-6 / extent.duration_h),
)
def offset_drift(field_sensor_T: Components, theta: Theta, circumstances: Circumstances) -> Components:
    """The zero of the sensor moves steadily."""
    return field_sensor_T + vector(theta, "xyz", "_T_per_h") * circumstances.hours[:, None]


@during(
    sensor_offset,
    words="from one instant on the sensor shows another constant in no field",
    source="contacts and amplifiers that were switched, as sensor_offset: 10 to 100 uT",
    starts=instants_within,  # elsewhere the step is nothing, or an offset of all its readings
)
def offset_step() -> None:
    """From one instant on the zero of the sensor is another: it was plugged in again, or its amplifier changed range."""


@spell(
    offset_step,
    words="for a while the sensor shows another constant in no field",
    source="another range of the amplifier, a contact: 10 to 100 uT",
)
def offset_spell() -> None:
    """For a while the zero of the sensor is another."""


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
    words="from one instant on another sensor reads, with gains and a zero of its own",
    source="sensors of one make differ as axis_gain, cross_axis and sensor_offset say",
    # Enough readings of either sensor to tell its constants: fewer readings follow any twelve numbers.
    starts=lambda circumstances, place: instants_within(circumstances, place, LEAST_SHARE),
)
def sensor_exchanged() -> None:
    """From one instant on another sensor hangs on the same cable, with gains, mixings and a zero of its own."""


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
    words="on one side of the mover's way the sensor has other gains and another zero",
    source="a worn cable or plug: per mille to per cents of a gain, and zeros as sensor_offset says",
    quantities=_contact,
    # Readings all on one side would have another gain and another zero.
    concerns=lambda circumstances, place: circumstances.moved_between(place),
    starts=_sides,
)
def sensor_contact(
    field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
) -> Components:
    """The sensor has other gains and another zero where the mover stands beyond some place along one axis: a cable pulls at its contact.

    The mover is that of the sensor, or of the first coil that has one where the sensor stands still.
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


@ReadingEffect.cause(
    words="in each segment of the session the sensor has another gain",
    source="ranges and excitation currents of Hall teslameters agree to 0.1 to 1 %",
    **_in_segments((normal("gain", "1", 0.01),)),
)
def segment_gain(field_sensor_T: Components, theta: Theta, circumstances: Circumstances) -> Components:
    """The sensor has another gain in each segment: another range, excitation or day."""
    return field_sensor_T * (1.0 + of_segment(theta, ("gain",), circumstances.segment))


@ReadingEffect.cause(
    words="in each segment of the session the sensor shows another constant in no field",
    source="zeroing in a chamber or in the field of the room leaves as much as sensor_offset says",
    **_in_segments(triple("xyz", "_T", "T", 50e-6)),
)
def segment_zero(field_sensor_T: Components, theta: Theta, circumstances: Circumstances) -> Components:
    """The sensor was zeroed anew before each segment."""
    return field_sensor_T + of_segment(theta, ("x_T", "y_T", "z_T"), circumstances.segment)


def _inside_the_largest(circumstances: Circumstances, place: str) -> Starts:
    """Just inside the sensor's largest reading, where a limit gathers readings."""
    largest_T = circumstances.largest_of_sensor_T(place)
    return tuple({"limit_T": share * largest_T} for share in CLIPPED_AT)


@ReadingEffect.cause(
    words="components beyond the sensor's range are cut off",
    source="any range; the readings show where it ends",
    quantities=lambda extent: (at_most("limit_T", "T", 0.2, 3.0, extent.largest_field_T),),
    starts=_inside_the_largest,
)
def range_clipping(field_sensor_T: Components, theta: Theta) -> Components:
    """Components beyond the range read as its end."""
    limit = theta["limit_T"][..., None, None]
    return torch.minimum(torch.maximum(field_sensor_T, -limit), limit)
