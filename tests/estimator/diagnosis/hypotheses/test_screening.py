"""Full fits of single causes."""

from __future__ import annotations

import pytest

from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.hypotheses.screening import in_full, screening
from estimator.effects.sensor import SensorOffset
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

OFFSET = Cause("sensor_offset", "hall")


@pytest.mark.parametrize("is_itself", [True, False])
def test_fit_that_has_left_its_cause_is_no_evidence_for_it(
    small_rig: Rig, small_session: Session, monkeypatch, is_itself
):
    """A cause that is no longer itself has no evidence, though it explains much."""
    monkeypatch.setattr(SensorOffset, "is_itself", lambda *_: is_itself)
    plain = fit_of(small_rig, with_wrong(small_rig, small_session.observations, OFFSET, {"x_T": 100e-6}))
    value, _, start = screening(plain, candidates(plain, [OFFSET]))[OFFSET]
    assert value > 20.0
    log_bayes_factor, full = in_full(plain, value, start)
    assert full.log_evidence - plain.log_evidence > 20.0
    assert (log_bayes_factor > 20.0) is is_itself
    assert is_itself or log_bayes_factor == 0.0
