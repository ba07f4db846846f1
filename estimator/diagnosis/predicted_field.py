"""What sensors show in the field that `predict` gives: that of one moment, without what only the readings of a session have."""

from __future__ import annotations

from collections.abc import Collection

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.effects import EFFECTS
from estimator.effects.use import as_meant
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Values
from estimator.rig.rig import Cause

MOSTLY = 0.5  # of what a cause changes in readings: a predicted field that lacks more of it does not have the cause


def shown_by_prediction_T(
    fit: Fit, readings: Observations, values: Values | None = None, beside: Collection[Cause] = ()
) -> Float[Tensor, "reading 3"]:
    """What sensors show in the field that a calibration predicts where they stood, in T.

    It may be differentiated in the numbers. Sensors keep their response and their zero. Departures of sensors and movers, instants, drifts
    and what currents did before are in no predicted field. Inside a winding a prediction has no value: the sensor is given that of the fit.

    Args:
        fit: The rig and its numbers.
        readings: Where sensors stood, and the currents.
        values: Other numbers of the same rig; those of the fit by default.
        beside: Departures of sensors and movers that act all the same.
    """
    rig, values, readings = fit.rig, fit.values if values is None else values, as_meant(fit.rig, readings)
    for correction in set(rig.corrections).difference(beside):
        rig = rig.without_cause(correction)
    own = {name: value for name, value in values.items() if name in rig.parameters}
    model = MeasurementModel.unruled(rig, readings)
    n_rows = len(model.every_row)
    poses = model.world_from_sensor(model.every_row, own)
    turn = poses.rotation.expand(n_rows, 3, 3)[model.pose_row]
    places_m = poses.translation_m.expand(n_rows, 3)[model.pose_row]
    about = {name: value.detach() for name, value in values.items()}
    room = RoomField(fit.rig, about, places_m, dict(readings.motion))
    field_T = room.field_by_point_T(values, readings.current_A)
    shown_T = model.shown_T(own, torch.einsum("nij,...ni->...nj", turn, field_T)).expand(len(readings), 3)
    if room.is_inside.any():
        shown_T = torch.where(shown_T.isnan(), fit.model_of(readings).predict(values), shown_T)
    return shown_T


def missed_in_any_session_T(fit: Fit, readings: Observations) -> float:
    """Root mean square length by which the predicted field misses readings, with departures of sensors and movers that stay as they are.

    Args:
        fit: The rig and its numbers.
        readings: Where sensors stood, and what they showed.
    """
    lasting = [
        cause
        for cause in fit.rig.corrections
        if all(
            EFFECTS[cause.name].beyond_the_moment(name.removeprefix(f"{cause.label}.")) is None
            for name in fit.rig.parameters
            if name.startswith(f"{cause.label}.")
        )
    ]
    meant = as_meant(fit.rig, readings)
    with torch.no_grad():
        error_T = meant.field_sensor_T - shown_by_prediction_T(fit, meant, beside=lasting)
    return float(error_T.nan_to_num().square().sum(-1).mean().sqrt())


def not_predicted(fit: Fit, readings: Observations) -> tuple[Cause, ...]:
    """Causes of a rig that change readings of a session and are mostly absent from the field that `predict` gives.

    Args:
        fit: The rig and its numbers.
        readings: Some of the session.
    """
    meant = as_meant(fit.rig, readings)
    model, result = fit.model_of(meant), []

    def changes_T(values: Values) -> tuple[Tensor, Tensor]:
        with torch.no_grad():
            return model.predict(values).expand(len(meant), 3), shown_by_prediction_T(fit, meant, values)

    read_T, predicted_T = changes_T(fit.values)
    for cause in fit.rig.acting:
        read_without_T, predicted_without_T = changes_T({**fit.values, **fit.null_values(cause)})
        of_readings_T, of_prediction_T = read_T - read_without_T, predicted_T - predicted_without_T
        lacking_T = (of_readings_T - of_prediction_T)[meant.is_measured].nan_to_num()
        if lacking_T.norm() > MOSTLY * of_readings_T[meant.is_measured].norm():
            result.append(cause)
    return tuple(result)
