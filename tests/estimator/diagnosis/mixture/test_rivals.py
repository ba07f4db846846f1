"""Causes in the place of a stated one, judged by full fits."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from estimator.diagnosis.mixture import rivals
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.full_fits import fit_with
from estimator.diagnosis.mixture.rivals import LEAST_CURVED, MOST_RIVALS, Rival, contenders, rival
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text
from tests.estimator.diagnosis.small_fits import answered, fit_of, with_wrong
from tests.estimator.diagnosis.test_stated import ARM, session

pytestmark = pytest.mark.whole

GAIN, SCALE = Cause("axis_gain", "hall"), Cause("robot_scale", "arm1")
BASE, PROBE = Cause("base_misplaced", "arm"), Cause("sensor_misplaced", "hall")


@pytest.fixture(scope="module")
def answer(small_rig, small_session, small_truth):
    truth = small_rig.with_values(small_truth)
    return answered(
        fit_of(small_rig, with_wrong(truth, small_session.observations.calibration, GAIN, {"z": 0.05}))
    )


def with_probe_off(off_m: float) -> Answer:
    """What readings say of a probe that stands elsewhere than its rig file has it."""
    rig = rig_from_text(ARM)
    return answered(fit_of(rig, session(rig, {f"{PROBE.label}.x_m": off_m}).observations.calibration))


def test_a_rival_takes_its_share_of_the_name_by_its_evidence(answer):
    alone = replace(answer, rivals={})
    (entry,) = alone.stated
    first = entry.first_listed
    rival = Rival(SCALE, alone.item_of(SCALE), math.log(0.25), {})
    (shared,) = replace(answer, rivals={first: (rival,)}).stated
    shares = {possibility.cause: possibility.share for possibility in shared.possibilities}
    assert shares[SCALE] == pytest.approx(0.25 * shares[first])
    assert shared.listed_share == pytest.approx(entry.listed_share)
    assert shared.probability == entry.probability


def test_contenders_have_most_of_the_evidence(answer):
    first, items = answer.stated[0].first_listed, answer.asked.dictionary.items
    comparison = answer.beside_item(answer.item_of(first), [first])
    factors = {h.cause: h.log_bayes_factor for h in comparison.hypotheses}
    able = [items[i].cause for i in contenders(comparison, first, [])]
    assert len(able) <= MOST_RIVALS
    assert all(factors[cause] > LEAST_CURVED * factors[first] for cause in able)
    without = [items[i].cause for i in contenders(comparison, first, able)]
    assert not set(able) & set(without)


def test_odds_of_rivals_are_those_of_the_linear_model_where_little_is_curved(monkeypatch):
    """Each about its own fit, and all about the rig as described: 0.3 mm, of many causes any."""
    monkeypatch.setattr(rivals, "LEAST_CURVED", 0.5)
    answer = with_probe_off(3e-4)
    first, items = answer.stated[0].first_listed, answer.asked.dictionary.items
    item = answer.item_of(first)
    p = {h.cause: h.probability for h in answer.alone.hypotheses}
    others = contenders(answer.beside_item(item, [first]), first, [])
    assert len(others) == MOST_RIVALS
    for other in others:
        cause = items[other].cause
        fits = (fit_with(answer, [each]) for each in (cause, first))
        odds = rival(answer.asked, other, next(fits), {first: item}, next(fits))
        assert odds.log_odds == pytest.approx(math.log(p[cause] / p[first]), abs=1.0)


def test_twins_stay_twins_where_one_is_fitted_and_the_other_is_curved():
    """No reading tells a probe that is off from a base that is; the model about a fit with the base has the probe far below it."""
    answer = with_probe_off(5e-3)
    (plain,), (entry,) = replace(answer, rivals={}).stated, answer.stated
    assert len(plain.possibilities) == 1
    assert {possibility.cause for possibility in entry.possibilities} == {BASE, PROBE}
    ((twin,),) = answer.rivals.values()
    assert abs(twin.log_odds) < 1.5
