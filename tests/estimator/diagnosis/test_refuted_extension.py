"""An extension that predicts unseen readings worse than the rig as described does not replace it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from torch import Tensor

from estimator import diagnose
from estimator.diagnosis import outcome, policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.headline import headline
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.validation import Improvement
from estimator.readings.observations import Observations
from tests.estimator.diagnosis.sessions import session_with

pytestmark = pytest.mark.whole


def test_rows_of_the_other_session_that_were_written_down_wrongly_judge_nothing():
    """One decimal point would change the log predictive density by millions."""
    hidden, currents_A = (("axis_gain.x", 0.02),), (3.0, -3.0, 1.5)
    other = session_with(hidden, currents_A, 2)
    field_T = other.observations.field_sensor_T.clone()
    rows = field_T.abs().amax(dim=1).topk(2).indices.sort().values.tolist()
    field_T[rows] *= 10.0
    wrong = replace(other, observations=other.observations.with_field(field_T))
    session = session_with(hidden, currents_A, 1)
    diagnosis, right = (
        diagnose(session, validation=validation, seed=1, has_corrections=False, limits=Limits(2))
        for validation in (wrong, other)
    )
    (flag,) = diagnosis.findings.judging_flags
    assert (flag.words, list(flag.readings)) == ("is ten times too large", rows)
    assert not diagnosis.findings.flags
    assert diagnosis.verdict == right.verdict != "unexplained"
    assert [named.cause.name for named in diagnosis.causes] == ["axis_gain"]
    assert diagnosis.improvement is not None
    assert right.improvement is not None
    assert diagnosis.improvement.elpd_difference == pytest.approx(right.improvement.elpd_difference, abs=20.0)
    (record,) = diagnosis.to_json()["flagged_in_validation"]
    assert record["readings"] == [row + 1 for row in rows]
    words = " ".join(headline(diagnosis))
    opening = "Readings of the session for validation are not as they were measured: hall is ten times too large, in readings "
    assert opening in words
    assert "They judge nothing." in words


def test_what_unseen_readings_refute_is_not_predicted_with(monkeypatch):
    real = outcome.improvement_of

    def worse(before: Fit, after: Fit, unseen: Observations, *covariance: Tensor) -> Improvement:
        improvement: Improvement = real(before, after, unseen, *covariance)
        is_extended = bool(after.rig.effects)
        return replace(improvement, elpd_difference=-100.0, elpd_se=1.0) if is_extended else improvement

    monkeypatch.setattr(outcome, "improvement_of", worse)
    diagnosis = diagnose(
        session_with((("axis_gain.x", 0.05),), (3.0, -3.0, 1.5), 1), seed=1, limits=Limits(2)
    )
    assert diagnosis.findings.answer.stated
    assert diagnosis.verdict == "unexplained"
    assert not diagnosis.causes
    words = " ".join(headline(diagnosis))
    assert "Refuted by unseen readings: the sensor's axes have wrong gains (axis_gain" in words
    assert "no known cause is probable" not in words
    assert not diagnosis.findings.stand_ins
    assert not diagnosis.extended_rig.effects
    improvement = diagnosis.improvement
    assert improvement is not None
    if not diagnosis.extended_rig.corrections:
        assert improvement.after.errors.vector_T == improvement.before.errors.vector_T


def test_intervals_that_are_too_wide_refute_no_name(monkeypatch):
    real = outcome.improvement_of

    def worse_if_widened(
        before: Fit, after: Fit, unseen: Observations, covariance: Tensor | None = None
    ) -> Improvement:
        improvement: Improvement = real(before, after, unseen, covariance)
        return (
            improvement if covariance is None else replace(improvement, elpd_difference=-100.0, elpd_se=1.0)
        )

    monkeypatch.setattr(outcome, "improvement_of", worse_if_widened)
    monkeypatch.setattr(Answer, "leaves_something", True)
    diagnosis = diagnose(
        session_with((("axis_gain.x", 0.05),), (3.0, -3.0, 1.5), 1),
        seed=1,
        has_corrections=False,
        limits=Limits(2),
    )
    assert diagnosis.left_open.widening is not None
    assert diagnosis.verdict == "partly_explained"
    assert [named.cause.name for named in diagnosis.causes] == ["axis_gain"]


def test_a_cause_that_is_next_to_nothing_in_unseen_readings_is_told_without_a_name(monkeypatch):
    monkeypatch.setattr(policy, "NEGLIGIBLE_SHARE", 10.0)
    diagnosis = diagnose(
        session_with((("axis_gain.x", 0.05),), (3.0, -3.0, 1.5), 1), seed=1, limits=Limits(2)
    )
    assert not diagnosis.causes
    assert [cause.name for cause in diagnosis.findings.stand_ins] == ["axis_gain"]
    words = " ".join(headline(diagnosis))
    assert (
        "Clear, but less than 1 % of the misfit of unseen readings: the sensor's axes have wrong gains"
        in words
    )
