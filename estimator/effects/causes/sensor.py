"""What a three-axis Hall sensor says instead of the field: its response and its zero."""

from __future__ import annotations

from itertools import permutations

from estimator.effects.base import Quantity, Theta, normal, triple, vector
from estimator.effects.circumstances import Circumstances
from estimator.effects.during import during, instants_within, spell, spells_of
from estimator.effects.stages import Components, Current, ReadingEffect
from estimator.rig.parameters import LogNormal
from estimator.tensors import torch

# xy: what the x axis picks up of the y component.
PAIRS = tuple("".join(pair) for pair in permutations("xyz", 2))


@ReadingEffect.cause(quantities=triple(PAIRS, "", "1", 0.01))
def cross_axis(field_sensor_T: Components, theta: Theta) -> Components:
    """The sensor's axes pick up each other's components.

    Each axis picks up a share of the other components.

    Source: elements are mounted to 0.2 to 1 degree; cross sensitivity up to 1 %.
    """
    zero = torch.zeros_like(theta["xy"])
    rows = [[theta[a + b] if a != b else zero for b in "xyz"] for a in "xyz"]
    mix = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
    return field_sensor_T + (mix[..., None, :, :] @ field_sensor_T[..., None])[..., 0]


@ReadingEffect.cause(quantities=triple("xyz", "", "1", 0.01), is_in_every_device=True)
def axis_gain(field_sensor_T: Components, theta: Theta) -> Components:
    """The sensor's axes have wrong gains.

    Each axis has a gain of its own.

    Source: Hall teslameters are specified to 0.1 to 1 % (Metrolab THM1176: 1 %).
    """
    return field_sensor_T * (1.0 + vector(theta, "xyz"))


@during(
    axis_gain, ends=True, starts=lambda circumstances, place: spells_of(circumstances, place, has_ends=True)
)
def gain_spell() -> None:
    """For a while the sensor's axes have other gains.

    For a while the sensor's axes have other gains: another range, or numbers in another unit.

    No cause says that gains alone change and stay, so a spell may begin with the session or last until after it.

    Source: ranges of one amplifier agree to 0.1 to 2 %.
    """


@ReadingEffect.cause(
    quantities=lambda extent: triple("xyz", "_per_T2", "1/T2", 0.01 / extent.largest_field_T**2)
)
def cubic_response(field_sensor_T: Components, theta: Theta) -> Components:
    """The sensor's response is not linear in the field.

    A relative error that grows with the square of the component.

    Source: linearity of Hall sensors, 0.1 to 1 % of range.
    """
    return field_sensor_T + vector(theta, "xyz", "_per_T2") * field_sensor_T**3


@ReadingEffect.cause(quantities=lambda extent: triple("xyz", "_per_T", "1/T", 0.01 / extent.largest_field_T))
def planar_hall(field_sensor_T: Components, theta: Theta) -> Components:
    """Each axis adds the product of the two other components.

    The planar Hall effect: each axis adds the product of the two components in its plane.

    Source: planar Hall voltage of silicon elements, up to 1 % of the field.
    """
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


@ReadingEffect.cause(quantities=PER_KELVIN, concerns=_has_warmed)
def temperature_drift(
    field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
) -> Components:
    """The sensor's gain and zero follow its temperature.

    Gain and zero of the sensor follow its temperature.

    Source: temperature coefficients of Hall sensors: 100 to 1000 ppm/K, 1 to 10 uT/K.
    """
    return _at_temperature(field_sensor_T, theta, circumstances.temperature_K(sensor))


@ReadingEffect.cause(
    quantities=(*PER_KELVIN, Quantity("tau_h", "h", LogNormal(0.3, 1.0), 0.3, is_shape=True)),
    starts=({"tau_h": 0.1}, {"tau_h": 0.3}, {"tau_h": 1.0}),  # a small probe, one in a holder, a heavy one
    concerns=_has_warmed,
    depends_on="the temperatures before",
)
def thermal_lag(
    field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
) -> Components:
    """The sensor's gain and zero follow its thermometer late.

    Gain and zero of the sensor follow a temperature that lags behind its thermometer.

    Source: coefficients as of temperature_drift; a probe in its holder follows the air in 5 minutes to an hour.
    """
    return _at_temperature(field_sensor_T, theta, circumstances.lagged_K(sensor, theta["tau_h"]))


@ReadingEffect.cause(quantities=triple("xyz", "_T", "T", 50e-6), is_everywhere=True)
def sensor_offset(field_sensor_T: Components, theta: Theta) -> Components:
    """The sensor has a zero offset.

    It shows a constant where there is no field.

    Source: zero errors of Hall sensors, 10 to 100 uT.
    """
    return field_sensor_T + vector(theta, "xyz", "_T")


# Quantities: change per hour from the beginning of the session on.
@ReadingEffect.cause(quantities=lambda extent: triple("xyz", "_T_per_h", "T/h", 50e-6 / extent.duration_h))
def offset_drift(field_sensor_T: Components, theta: Theta, circumstances: Circumstances) -> Components:
    """The zero of the sensor drifts.

    The zero of the sensor moves steadily.

    Source: some 10 uT while electronics warm up.
    """
    return field_sensor_T + vector(theta, "xyz", "_T_per_h") * circumstances.hours[:, None]


@during(
    sensor_offset,
    starts=instants_within,  # elsewhere the step is nothing, or an offset of all its readings
)
def offset_step() -> None:
    """From one instant on the sensor has another zero offset.

    From one instant on the zero of the sensor is another: it was plugged in again, or its amplifier changed range.

    Source: contacts and amplifiers that were switched, as sensor_offset: 10 to 100 uT.
    """


@spell(offset_step)
def offset_spell() -> None:
    """For a while the sensor has another zero offset.

    For a while the zero of the sensor is another.

    Source: another range of the amplifier, a contact: 10 to 100 uT.
    """
