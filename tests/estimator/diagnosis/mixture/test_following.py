"""Readings at the limit of a range, which follow the rig's numbers no longer."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.confirmed import answer
from estimator.diagnosis.mixture.following import limiting, stalled
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole

CLIPPING, GAIN = Cause("range_clipping", "hall"), Cause("axis_gain", "hall")


@pytest.fixture(scope="module")
def made(small_rig: Rig, small_session: Session) -> Answer:
    """What readings say of a sensor that shows no more than some field, and whose axes have wrong gains."""
    limit_T = 0.8 * float(small_session.observations.field_sensor_T.abs().max())
    wrong = with_wrong(small_rig, small_session.observations, GAIN, {"x": 0.02})
    clipped = with_wrong(small_rig, wrong, CLIPPING, {"limit_T": limit_T}).calibration
    return answer(fit_of(small_rig, clipped), Limits(), 1, n_pairs=1)


def test_readings_at_a_limit_follow_nothing_and_the_cause_of_it_is_known(made):
    fit = made.asked.expansion.fit
    is_at_limit = fit.predicted_T.abs() > (1.0 - 1e-9) * float(fit.values[f"{CLIPPING.label}.limit_T"])
    assert 0 < int(is_at_limit.sum()) < 0.2 * len(is_at_limit)
    torch.testing.assert_close(stalled(made.plain, fit), is_at_limit)
    assert limiting(made.plain, fit) == {CLIPPING}


def test_a_gain_keeps_readings_following(made, small_rig):
    gain = fit_of(small_rig, made.plain.observations, GAIN)
    assert not stalled(made.plain, gain).any()
    assert limiting(made.plain, gain) == frozenset()


def test_a_limit_is_stated_beside_another_cause(made):
    """About a fit with it, a gain that steps seemed to explain what readings would be without it."""
    assert CLIPPING in {entry.first_listed for entry in made.stated}
