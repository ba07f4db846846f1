"""The fit that a diagnosis begins with is made and judged without the readings that a sensor repeated while it was moved."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimator.diagnosis import effort
from estimator.diagnosis.first_fit import FirstFit
from estimator.diagnosis.result import Question
from estimator.readings.flags import Reason
from estimator.store.session import Session

pytestmark = pytest.mark.whole

HELD = list(range(22, 33))


@pytest.fixture
def held(small_session):
    """The session with a sensor that stood still for eleven readings, some of them for validation."""
    readings = small_session.observations
    field_T = readings.field_sensor_T.clone()
    field_T[HELD] = readings.field_sensor_T[HELD[0] - 1]
    return replace(small_session, observations=readings.with_field(field_T))


def first_fit(session: Session, validation: Session | None = None) -> FirstFit:
    question = Question(session.rig, session.source, 0)
    return FirstFit.of(question, session, validation, effort.MOST_READINGS_SEARCHED)


def test_neither_the_fit_nor_its_judge_has_readings_that_were_held(held):
    assert bool(held.observations.is_validation[HELD].any())
    first = first_fit(held)
    (flag,) = first.flags
    assert (flag.reason, list(flag.readings)) == (Reason.HELD, HELD)
    left = first.session.observations.is_measured.any(dim=1)
    assert (~left).nonzero().flatten().tolist() == HELD
    assert len(first.seen) + len(first.unseen) == len(first.measured.observations) == int(left.sum())
    assert not first.suspects().flags


def test_nor_has_another_session_that_judges(small_session, held):
    first = first_fit(small_session, held)
    unseen, flags = first.judging(first.plain)
    assert [list(flag.readings) for flag in flags] == [HELD]
    assert not bool(unseen.is_measured[HELD].any())
