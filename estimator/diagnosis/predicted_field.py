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


class PredictedReadings:
    """What sensors show in the field that a calibration predicts where they stood.

    Sensors keep their response and their zero. Departures of sensors and movers, instants, drifts and what currents did before are in no
    predicted field. Inside a winding a prediction has no value: the sensor is given that of the fit. How finely windings are summed is
    chosen once, about the fit.

    Args:
        fit: The rig and its numbers.
        readings: Where sensors stood, and the currents.
        beside: Departures of sensors and movers that act all the same.
    """

    def __init__(self, fit: Fit, readings: Observations, beside: Collection[Cause] = ()) -> None:
        rig, self._fit, self._readings = fit.rig, fit, as_meant(fit.rig, readings)
        for correction in set(rig.corrections).difference(beside):
            rig = rig.without_cause(correction)
        self._model = MeasurementModel.unruled(rig, self._readings)
        places_m, _ = self._places(fit.values)
        self._room = RoomField(fit.rig, fit.values, places_m.detach(), dict(self._readings.motion))

    def _places(self, values: Values) -> tuple[Float[Tensor, "reading 3"], Float[Tensor, "reading 3 3"]]:
        """Places and rotations of the sensors, by reading."""
        model, n_rows = self._model, len(self._model.every_row)
        own = {name: value for name, value in values.items() if name in model.rig.parameters}
        poses = model.world_from_sensor(model.every_row, own)
        places_m, turn = poses.translation_m.expand(n_rows, 3), poses.rotation.expand(n_rows, 3, 3)
        return places_m[model.pose_row], turn[model.pose_row]

    def shown_T(self, values: Values) -> Float[Tensor, "reading 3"]:
        """Readings at some numbers of the rig, in T; it may be differentiated in them."""
        model, readings = self._model, self._readings
        places_m, turn = self._places(values)
        field_T = self._room.field_by_point_T(values, readings.current_A, places_m)
        own = {name: value for name, value in values.items() if name in model.rig.parameters}
        shown_T = model.shown_T(own, torch.einsum("nij,...ni->...nj", turn, field_T))
        shown_T = shown_T.expand(len(readings), 3)
        if self._room.is_inside.any():
            of_fit_T = self._fit.model_of(readings).predict(values)
            shown_T = torch.where(shown_T.isnan(), of_fit_T, shown_T)
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
        if all(EFFECTS[cause.name].beyond_the_moment(key) is None for key in fit.rig.names_of(cause))
    ]
    meant = as_meant(fit.rig, readings)
    with torch.no_grad():
        error_T = meant.field_sensor_T - PredictedReadings(fit, meant, lasting).shown_T(fit.values)
    return float(error_T.nan_to_num().square().sum(-1).mean().sqrt())


def not_predicted(fit: Fit, readings: Observations) -> tuple[Cause, ...]:
    """Causes of a rig that change readings of a session and are mostly absent from the field that `predict` gives.

    Args:
        fit: The rig and its numbers.
        readings: Some of the session.
    """
    meant = as_meant(fit.rig, readings)
    model, predicted, result = fit.model_of(meant), PredictedReadings(fit, meant), []

    def changes_T(values: Values) -> tuple[Tensor, Tensor]:
        with torch.no_grad():
            return model.predict(values).expand(len(meant), 3), predicted.shown_T(values)

    read_T, predicted_T = changes_T(fit.values)
    for cause in fit.rig.acting:
        read_without_T, predicted_without_T = changes_T({**fit.values, **fit.null_values(cause)})
        of_readings_T, of_prediction_T = read_T - read_without_T, predicted_T - predicted_without_T
        lacking_T = (of_readings_T - of_prediction_T)[meant.is_measured].nan_to_num()
        if lacking_T.norm() > MOSTLY * of_readings_T[meant.is_measured].norm():
            result.append(cause)
    return tuple(result)
