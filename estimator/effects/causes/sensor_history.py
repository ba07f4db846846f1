"""What a sensor says instead of the field because of what was shown before: it lags, or keeps what another sensor showed."""

from __future__ import annotations

from jaxtyping import Float

from estimator.effects.base import Starts, Theta, at_least_zero, normal
from estimator.effects.circumstances import Circumstances
from estimator.effects.history import LONG_AGO_S
from estimator.effects.stages import Components, ReadingEffect
from estimator.readings.observations import SECONDS_PER_HOUR
from estimator.tensors import Tensor, torch

# Shares of the time between readings: 0.1 % to a quarter is left of the reading before.
LAGS = (0.15, 0.25, 0.4, 0.7)
LEAST_TAU_S = 1e-6  # shorter than any dwell by so much that nothing is left


def _dwells_s(circumstances: Circumstances, sensor: str) -> Float[Tensor, " dwell"]:
    """Times between readings of a sensor."""
    _, ago_s = circumstances.of_history.previous(sensor)
    return ago_s[ago_s < LONG_AGO_S]


def _shares_of_a_dwell(circumstances: Circumstances, place: str) -> Starts:
    """Shares of the time between readings: at zero, no derivative shows anything."""
    dwells_s = _dwells_s(circumstances, place)
    typical_s = float(dwells_s.median()) if len(dwells_s) else 1.0
    return tuple({"tau_s": share * typical_s} for share in LAGS)


@ReadingEffect.cause(
    quantities=lambda extent: (at_least_zero("tau_s", "s", 0.1 * extent.interval_h * SECONDS_PER_HOUR),),
    starts=_shares_of_a_dwell,
    # Readings of the sensor follow one another in time.
    concerns=lambda circumstances, place: len(_dwells_s(circumstances, place)) > 0,
    depends_on="the reading before",
)
def sensor_lag(
    field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
) -> Components:
    """The sensor is read before it has settled.

    The sensor is read before it has settled: a share of what it showed at the reading before is left.

    shown = field + (shown before - field) exp(-dwell / tau): a filter of the first order, and a field that jumps at the beginning of each
    dwell. What was shown before is what was recorded, with its noise, of which a small share enters; a component that was not recorded
    before counts as settled. In a session without any recorded field, such as one to be simulated, it follows from the fields themselves.

    Source: filters of teslameters, 10 ms to 1 s; stops of 0.5 to 10 s are meant to be ten times as long.
    """
    row, ago_s = circumstances.previous(sensor)
    left = torch.exp(-ago_s / theta["tau_s"].clamp(min=LEAST_TAU_S)[..., None])[..., None]
    own = circumstances.sensor_number(sensor)
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


def _follows_another(circumstances: Circumstances, place: str) -> bool:
    """Whether another sensor was read before this one."""
    row = circumstances.read_before(place)
    return bool((row >= 0)[circumstances.is_of(place)].any())


# Quantities: of the channel before.
@ReadingEffect.cause(
    quantities=(normal("share", "1", 0.02),),
    places=lambda rig: tuple(sensor.name for sensor in rig.sensors) if len(rig.sensors) > 1 else (),
    concerns=_follows_another,
    depends_on="the reading of another sensor before",
)
def channel_crosstalk(
    field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
) -> Components:
    """The sensor keeps a share of what was read on the channel before.

    The sensor keeps a share of what the sensor that was read just before it showed, axis by axis: a multiplexer before one converter.

    shown = field + share (shown by the sensor before - field). What that showed is what was recorded, with its noise, of which a small
    share enters; a component that was not recorded changes nothing. In a session without any recorded field, such as one to be simulated,
    it is the field at that sensor.

    Source: multiplexers that switch faster than their converter settles, 0.01 to 5 % of the channel before.
    """
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
