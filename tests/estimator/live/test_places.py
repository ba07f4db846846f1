"""Places of readings are where the model puts the sensor, with residuals that are turned and not stretched."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from estimator.live.picture import places
from estimator.live.stream import Stream
from estimator.model.measurement_model import MeasurementModel


def test_residuals_keep_their_length_and_stand_where_the_sensor_was(small_session):
    readings, rig = small_session.observations.alone, small_session.rig
    stream = Stream(rig)
    stream.update(readings)
    found = places(rig, stream.values, readings, range(1, len(readings) + 1))
    model = MeasurementModel.build(rig, readings)
    residual_T = readings.field_sensor_T - model.predict(stream.values).expand(len(readings), 3)
    position_m, _ = model.readings_in_coil(rig.coils[0], stream.values)
    for row, place in enumerate(found):
        assert place.number == row + 1
        assert place.position_m == pytest.approx(position_m[row].tolist())
        assert torch.tensor(place.residual_T).norm() == pytest.approx(float(residual_T[row].norm()), rel=1e-5)
        assert place.is_fitted is not bool(readings.is_validation[row])
    assert sum(place.rms_sigma**2 for place in found) / len(found) == pytest.approx(1.0, abs=0.4)


def test_readings_without_a_component_have_no_place(small_session):
    readings = small_session.observations.alone
    field_T = readings.field_sensor_T.clone()
    field_T[1] = torch.nan
    field_T[2, 0] = torch.nan
    partly = replace(readings, field_sensor_T=field_T)
    stream = Stream(small_session.rig)
    found = places(small_session.rig, stream.values, partly, range(len(partly)))
    assert [place.number for place in found[:3]] == [0, 2, 3]
    assert all(math.isfinite(number) for place in found for number in (*place.residual_T, place.rms_sigma))
