"""Several sessions name what one cannot; chance and things unknown are not named by being repeated."""

from __future__ import annotations

import importlib
import json

import numpy as np
import pytest

from estimator.recalibration.comparison import named_together
from estimator.recalibration.conclusion import EVIDENCE, Conclusion, Judgement
from estimator.recalibration.recalibrate import recalibrate
from estimator.recalibration.registry import Registry
from estimator.rig.rig import Rig
from estimator.store.session import Session

recalibrate_module = importlib.import_module("estimator.recalibration.recalibrate")
CAUSES = [f"cause{i}" for i in range(40)]


def session(unexplained: float = 0.0, **factors: float) -> dict[str, float]:
    return dict.fromkeys(CAUSES, -1.0) | factors | {"nothing": 0.0, "unexplained": unexplained}


def test_two_weak_sessions_name_their_common_cause_and_one_does_not():
    weak = session(2.0, cause3=6.0)
    assert named_together([weak]) == {}
    assert named_together([weak, weak]) == {"cause3": pytest.approx(1.0, abs=1e-3)}


def test_what_a_session_cannot_tell_apart_stays_a_set():
    weak = session(cause3=6.0, cause4=5.5)
    assert list(named_together([weak, weak])) == ["cause3", "cause4"]


def test_a_leader_by_chance_is_not_named_when_the_next_session_has_another():
    random = np.random.default_rng(4)
    for _ in range(200):
        first, second = random.choice(CAUSES, 2, replace=False)
        assert named_together([session(**{first: 6.0}), session(**{second: 6.0})]) == {}


def test_something_unknown_that_stays_is_not_given_the_name_of_what_imitates_part_of_it():
    part = session(20.0, cause3=12.0)
    assert named_together([part, part, part]) == {}


def test_no_session_and_no_cause_name_nothing():
    assert named_together([]) == {}
    assert named_together([{"nothing": 0.0, "unexplained": 9.0}]) == {}


def test_the_job_hands_on_the_evidence_of_sessions_in_a_row_that_disagreed(
    monkeypatch, small_session, small_rig, small_calibration, tmp_path
):
    agreed = iter([None, False, True, False, False, False])
    handed = []

    def judged(_session: Session, _rig: Rig, _current: object, *, earlier: object, **_: object) -> Judgement:
        handed.append(earlier)
        agrees = next(agreed)
        if agrees is None:
            return Judgement(Conclusion.UPDATED, "first", small_calibration)
        checks = {} if agrees else {EVIDENCE: {"cause": float(len(handed))}}
        return Judgement(Conclusion.REJECTED, "", agrees=agrees, checks=checks)

    monkeypatch.setattr(recalibrate_module, "judge", judged)
    inbox = tmp_path / "inbox"
    for week in range(6):
        taken = f"2026-01-0{week + 1}T09:00:00+00:00"
        readings = small_session.observations
        other = readings.with_field(readings.field_sensor_T + week * 1e-9)
        Session(small_rig, other, f"week {week}", taken).save(inbox / f"{week}.zarr")
    recalibrate(small_rig, inbox, tmp_path / "registry")
    numbers = [[evidence["cause"] for evidence in earlier] for earlier in handed]
    assert numbers == [[], [], [2.0], [], [4.0], [5.0, 4.0]]
    log = Registry(tmp_path / "registry").entries()
    assert json.loads(json.dumps(log[-1].checks)) == {EVIDENCE: {"cause": 6.0}}
