"""What a sensor says instead of the field because of what was before: it lags, keeps what another showed, is still cold, was exchanged."""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import WHEN, Quantity, Theta, at_least_zero, normal, since
from estimator.effects.causes.sensor import (
    AxisGain,
    CrossAxis,
    SensorOffset,
    TemperatureDrift,
    at_temperature,
)
from estimator.effects.circumstances import LONG_AGO_S, Circumstances, Extent
from estimator.effects.stages import ReadingEffect
from estimator.readings.observations import SECONDS_PER_HOUR
from estimator.rig.parameters import LogNormal
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

# Shares of the time between readings: 0.1 % to a quarter is left of the reading before.
LAGS = (0.15, 0.25, 0.4, 0.7)
LEAST_TAU_S = 1e-6  # shorter than any dwell by so much that nothing is left
LEAST_SHARE = 0.2  # of a sensor's readings that each of two exchanged sensors has
DRIFT = TemperatureDrift()
PARTS = (CrossAxis(), AxisGain(), SensorOffset())  # of a sensor, in the order in which they act


class SensorLag(ReadingEffect):
    """The sensor is read before it has settled: a share of what it showed at the reading before is left.

    shown = field + (shown before - field) exp(-dwell / tau): a filter of the first order, and a field that jumps at the beginning of each
    dwell. What was shown before is what was recorded, with its noise, of which a small share enters; a component that was not recorded
    before counts as settled. In a session without any recorded field, such as one to be simulated, it follows from the fields themselves.
    """

    name: ClassVar[str] = "sensor_lag"
    words: ClassVar[str] = "the sensor is read before it has settled"
    source: ClassVar[str] = (
        "filters of teslameters, 10 ms to 1 s; stops of 0.5 to 10 s are meant to be ten times as long"
    )

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Time constant in s."""
        return (at_least_zero("tau_s", "s", 0.1 * extent.interval_h * SECONDS_PER_HOUR),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Shares of the time between readings: at zero, no derivative shows anything."""
        dwells_s = _dwells_s(circumstances, place)
        typical_s = float(dwells_s.median()) if len(dwells_s) else 1.0
        return tuple({"tau_s": share * typical_s} for share in LAGS)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether readings of the sensor follow one another in time."""
        return len(_dwells_s(circumstances, place)) > 0

    def beyond_the_moment(self, key: str) -> str | None:
        """What was shown before is history."""
        return "the reading before"

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        row, ago_s = circumstances.previous(sensor)
        left = torch.exp(-ago_s / theta["tau_s"].clamp(min=LEAST_TAU_S)[..., None])[..., None]
        own = [s.name for s in circumstances.rig.sensors].index(sensor)
        history = circumstances.observations.history
        if history.is_measured[history.sensor == own].any():
            before_T = history.field_sensor_T[row].to(field_sensor_T.dtype)
            before_T = torch.where(torch.isnan(before_T), field_sensor_T, before_T)
            return field_sensor_T + left * (before_T - field_sensor_T)
        in_time = torch.argsort(circumstances.observations.row)
        in_time = in_time[circumstances.sensor[in_time] == own]
        if not len(in_time):
            return field_sensor_T
        field_sensor_T, left = torch.broadcast_tensors(field_sensor_T, left)
        shown_T: list[Tensor] = []
        for field_T, share in zip(
            field_sensor_T[..., in_time, :].unbind(-2), left[..., in_time, :].unbind(-2), strict=True
        ):
            shown_T.append(field_T + share * (shown_T[-1] - field_T) if shown_T else field_T)
        return field_sensor_T.index_copy(-2, in_time, torch.stack(shown_T, dim=-2))


class ChannelCrosstalk(ReadingEffect):
    """The sensor keeps a share of what the sensor that was read just before it showed, axis by axis: a multiplexer before one converter.

    shown = field + share (shown by the sensor before - field). What that showed is what was recorded, with its noise, of which a small
    share enters; a component that was not recorded changes nothing. In a session without any recorded field, such as one to be simulated,
    it is the field at that sensor.
    """

    name: ClassVar[str] = "channel_crosstalk"
    words: ClassVar[str] = "the sensor keeps a share of what was read on the channel before"
    source: ClassVar[str] = (
        "multiplexers that switch faster than their converter settles, 0.01 to 5 % of the channel before"
    )

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Share of the channel before."""
        return (normal("share", "1", 0.02),)

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Each sensor, where there are two."""
        return super().places(rig) if len(rig.sensors) > 1 else ()

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether another sensor was read before this one."""
        row = circumstances.read_before(place)
        return bool((row >= 0)[circumstances.is_of(place)].any())

    def beyond_the_moment(self, key: str) -> str | None:
        """What was read before is history."""
        return "the reading of another sensor before"

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        row = circumstances.read_before(sensor)
        history = circumstances.observations.history
        if history.is_measured.any():
            before_T = history.field_sensor_T[row.clamp(min=0)].to(field_sensor_T.dtype)
        elif len(circumstances.observations) == len(history):
            before_T = field_sensor_T[..., torch.argsort(circumstances.observations.row)[row.clamp(min=0)], :]
        else:
            return field_sensor_T
        is_known = (row >= 0)[:, None] & ~torch.isnan(before_T)
        change_T = torch.where(is_known, before_T - field_sensor_T, 0.0)
        return field_sensor_T + theta["share"][..., None, None] * change_T


def _starts_within(
    circumstances: Circumstances, sensor: str, least_share: float
) -> tuple[dict[str, float], ...]:
    """Instants with a reading of the sensor, and at least such a share of its readings, before and after."""
    hours = circumstances.hours[circumstances.is_of(sensor)]
    least = max(1.0, least_share * len(hours))
    n_after = [int((hours >= instant_h).sum()) for instant_h in circumstances.instants_h]
    each = zip(circumstances.instants_h, n_after, strict=True)
    return tuple({"since_h": instant_h} for instant_h, n in each if least <= n <= len(hours) - least)


def _dwells_s(circumstances: Circumstances, sensor: str) -> Float[Tensor, " dwell"]:
    """Times between readings of a sensor."""
    _, ago_s = Circumstances(circumstances.rig, circumstances.observations.history).previous(sensor)
    return ago_s[ago_s < LONG_AGO_S]


class ThermalLag(ReadingEffect):
    """Gain and zero of the sensor follow a temperature that lags behind its thermometer."""

    name: ClassVar[str] = "thermal_lag"
    words: ClassVar[str] = "the sensor's gain and zero follow its thermometer late"
    source: ClassVar[str] = (
        "coefficients as of temperature_drift; a probe in its holder follows the air in 5 minutes to an hour"
    )

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Coefficients of a sensor that follows its temperature at once, and the time constant of the lag, in h."""
        return (*DRIFT.quantities(extent), Quantity("tau_h", "h", LogNormal(0.3, 1.0), 0.3, is_shape=True))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """A small probe, one in a holder, a heavy one."""
        return tuple({"tau_h": tau_h} for tau_h in (0.1, 0.3, 1.0))

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the sensor's thermometer showed a change."""
        return DRIFT.concerns(circumstances, place)

    def beyond_the_moment(self, key: str) -> str | None:
        """What lags has a history."""
        return "the temperatures before"

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        kelvin = circumstances.lagged_K(sensor, theta["tau_h"])
        return field_sensor_T if kelvin is None else at_temperature(field_sensor_T, theta, kelvin)


class OffsetStep(ReadingEffect):
    """From one instant on the zero of the sensor is another: it was plugged in again, or its amplifier changed range."""

    name: ClassVar[str] = "offset_step"
    words: ClassVar[str] = "from one instant on the sensor shows another constant in no field"
    source: ClassVar[str] = "contacts and amplifiers that were switched, as sensor_offset: 10 to 100 uT"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Change of each component in the sensor frame, and the time since the session began from which on it is there."""
        return (*SensorOffset().quantities(extent), since(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Instants with readings of the sensor before and after: elsewhere the step is nothing, or an offset of all its readings."""
        return _starts_within(circumstances, place, 0.0)

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        zero_T = torch.stack([theta[f"{axis}_T"] for axis in "xyz"], dim=-1)
        return field_sensor_T + zero_T[..., None, :] * circumstances.is_meanwhile(theta)[..., None]


class SensorExchanged(ReadingEffect):
    """From one instant on another sensor hangs on the same cable, with gains, mixings and a zero of its own."""

    name: ClassVar[str] = "sensor_exchanged"
    words: ClassVar[str] = "from one instant on another sensor reads, with gains and a zero of its own"
    source: ClassVar[str] = "sensors of one make differ as axis_gain, cross_axis and sensor_offset say"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Gains, mixings and zero of the later sensor against the earlier one, and the time since the session began."""
        return (*(quantity for part in PARTS for quantity in part.quantities(extent)), since(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Instants with enough readings of either sensor to tell its constants: fewer readings follow any twelve numbers."""
        return _starts_within(circumstances, place, LEAST_SHARE)

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        changed_T = field_sensor_T
        for part in PARTS:
            changed_T = part.apply(changed_T, theta, circumstances, sensor)
        return torch.where(circumstances.is_meanwhile(theta)[..., None], changed_T, field_sensor_T)
