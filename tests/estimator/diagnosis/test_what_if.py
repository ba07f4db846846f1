"""What a cause would do, to first order: against the model with the cause, and against a fit that does not know of it."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.what_if import fit_for_what_if, possible_causes, what_if
from estimator.effects.attach import with_effect
from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.rig import Cause
from estimator.store.session import Session

pytestmark = pytest.mark.whole

GAIN = Cause("axis_gain", "hall")
SIZE = 0.004


@pytest.fixture(scope="module")
def fit(small_session: Session) -> Fit:
    return fit_for_what_if(small_session)


@pytest.fixture(scope="module")
def with_gain_T(fit: Fit) -> Tensor:
    """Readings of the fitted rig with a gain of the x axis that is wrong."""
    rig = with_effect(fit.rig, GAIN, fit.observations, {"x": SIZE}, is_free=False)
    model = MeasurementModel.unruled(rig, fit.observations).with_rules(fit.posterior.model.rules)
    values = {n: torch.as_tensor(v, dtype=torch.float64) for n, v in fit.start_with(rig).items()}
    with torch.no_grad():
        return model.predict(values).expand(len(fit.observations), 3)


def in_sensor_T(fit: Fit, vectors: list[list[float]]) -> Tensor:
    _, coil_from_sensor = fit.posterior.model.readings_in_coil(fit.rig.coils[0], fit.values)
    shown = torch.tensor(vectors, dtype=torch.float64)
    return (coil_from_sensor.mT @ shown[..., None])[..., 0]


def test_the_pattern_is_what_the_model_with_the_cause_adds(fit, with_gain_T):
    told = what_if(fit, GAIN.label)
    pattern = next(one for one in told.patterns if one.key == "x")
    predicted_T = fit.posterior.model.predict(fit.values).expand(len(fit.observations), 3)
    added_T = SIZE * in_sensor_T(fit, pattern.added_T)
    assert (added_T - (with_gain_T - predicted_T)).norm() < 0.01 * added_T.norm()
    assert told.coil == "coil1"
    assert len(told.position_m) == len(fit.observations)


def test_what_is_left_is_what_a_fit_without_the_cause_leaves(fit, with_gain_T):
    pattern = next(one for one in what_if(fit, GAIN.label).patterns if one.key == "x")
    predicted_T = fit.posterior.model.predict(fit.values).expand(len(fit.observations), 3)
    residual_T = fit.observations.field_sensor_T - predicted_T
    flawed = fit.observations.with_field(with_gain_T + residual_T)
    again = fit_rig(fit.rig, flawed, fit.values, fit.posterior.model.rules)
    left_T = flawed.field_sensor_T - again.posterior.model.predict(again.values).expand(len(flawed), 3)
    expected_T = SIZE * in_sensor_T(fit, pattern.left_T)
    assert (left_T - residual_T - expected_T).norm() < 0.05 * expected_T.norm()
    assert expected_T.norm() < 0.9 * (SIZE * torch.tensor(pattern.added_T)).norm()  # the fit takes up a part
    noise_T = float(fit.values["hall.noise_T"])
    rms_sigma = float(expected_T.norm()) / noise_T / (3 * len(flawed)) ** 0.5
    assert SIZE * pattern.left_sigma == pytest.approx(rms_sigma, rel=0.01)
    assert pattern.visible == pytest.approx(5.0 / (pattern.left_sigma * (3 * len(flawed)) ** 0.5))


def test_causes_are_those_that_could_be_there_and_others_are_refused(fit):
    labels = {one.label for one in possible_causes(fit)}
    assert GAIN.label in labels
    assert "two_sensors[hall]" not in labels
    for label in ("axis_gain[probe]", "nonsense", "unit_error[record]"):
        with pytest.raises(InvalidInput):
            what_if(fit, label)
