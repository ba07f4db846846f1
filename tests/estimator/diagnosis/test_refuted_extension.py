"""An extension that predicts unseen readings worse than the rig as described does not replace it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from torch import Tensor

from estimator import diagnose
from estimator.diagnosis import outcome
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.validation import Improvement
from estimator.readings.observations import Observations
from tests.estimator.diagnosis.sessions import session_with

pytestmark = pytest.mark.whole


def test_what_unseen_readings_refute_is_not_predicted_with(monkeypatch: pytest.MonkeyPatch) -> None:
    real = outcome.improvement_of

    def worse(before: Fit, after: Fit, unseen: Observations, *covariance: Tensor) -> Improvement:
        improvement: Improvement = real(before, after, unseen, *covariance)
        is_extended = bool(after.rig.effects)
        return replace(improvement, elpd_difference=-100.0, elpd_se=1.0) if is_extended else improvement

    monkeypatch.setattr(outcome, "improvement_of", worse)
    monkeypatch.setattr(outcome, "is_refuted", lambda *_: True)
    diagnosis = diagnose(session_with((("axis_gain.x", 0.05),), (3.0, -3.0, 1.5), 1), seed=1)
    assert diagnosis.findings.search.final.rig.effects
    assert diagnosis.verdict == "unexplained"
    assert not diagnosis.causes
    assert not diagnosis.findings.stand_ins
    assert not diagnosis.extended_rig.effects
    improvement = diagnosis.improvement
    assert improvement is not None
    if not diagnosis.extended_rig.corrections:
        assert improvement.after.errors.vector_T == improvement.before.errors.vector_T
