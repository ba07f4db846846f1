"""The model that columns of a cause come from, made from the model of a fit, is the one that is made anew."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.diagnosis.hypotheses.candidates import candidates, causes_of
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.small_fits import fit_of

pytestmark = pytest.mark.whole


def test_model_with_the_effects_of_another_rig_predicts_as_one_made_anew(small_rig, small_session):
    readings = small_session.observations
    current_A = readings.current_A.clone()
    current_A[::4] = 0.0  # so that poses without current matter, too
    fit = fit_of(small_rig, replace(readings, current_A=current_A))
    model, circumstances = fit.posterior.model, fit.posterior.model.circumstances
    causes = causes_of(small_rig, fit)
    assert len(causes) > 20
    for cause in causes:
        start = next(iter(EFFECTS[cause.name].starts(circumstances, cause.place)))
        rig = with_effect(small_rig, cause, fit.observations, start, is_free=False)
        quantities = EFFECTS[cause.name].quantities(circumstances.extent)
        moved = {
            f"{cause.label}.{q.key}": q.null + 0.1 * q.prior.sd
            for q in quantities
            if not q.is_shape and not q.is_positive
        }
        values = nominal_tensors(rig.with_values(moved))
        anew = MeasurementModel.unruled(rig, fit.observations).with_rules(model.rules)
        torch.testing.assert_close(
            model.with_effects_of(rig).predict(values), anew.predict(values), msg=cause.label
        )


def test_cause_that_makes_no_numbers_is_left_out_and_named(small_rig, small_session, monkeypatch, caplog):
    """As one from outside may that divides by a field of nothing: a verdict without it must not look like one that asked it."""
    fit = fit_of(small_rig, small_session.observations)
    broken = staticmethod(lambda field_sensor_T, *_: field_sensor_T / torch.zeros_like(field_sensor_T))
    monkeypatch.setattr(type(EFFECTS["axis_gain"]), "apply", broken)
    asked = candidates(fit, [Cause("axis_gain", "hall"), Cause("cross_axis", "hall")])
    assert {candidate.cause.name for candidate in asked} == {"cross_axis"}
    assert caplog.messages == [
        "axis_gain is not asked: readings with it, or their derivatives, are not all finite"
    ]
