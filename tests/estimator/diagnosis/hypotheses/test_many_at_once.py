"""In a pile several causes are taken at once: those that are there, chosen one beside the other."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate, candidates, causes_of
from estimator.diagnosis.hypotheses.many_at_once import chosen_one_by_one, many_at_once
from estimator.diagnosis.hypotheses.screening import screening
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole

OFFSET, CROSS = Cause("sensor_offset", "hall"), Cause("cross_axis", "hall")
HIDDEN = {OFFSET: {"x_T": 100e-6, "z_T": -80e-6}, CROSS: {"xy": 0.02, "zx": -0.015}}
ASKED = ("sensor_offset", "cross_axis", "offset_drift", "current_offset", "current_gain")
LEAST = 7.0


@pytest.fixture(scope="module")
def plain(small_rig: Rig, small_session: Session, small_truth: dict[str, float]) -> Fit:
    readings = small_session.observations
    for cause, size in HIDDEN.items():
        readings = with_wrong(small_rig.with_values(small_truth), readings, cause, size)
    return fit_of(small_rig, readings.calibration)


@pytest.fixture(scope="module")
def pool(plain: Fit) -> list[Candidate]:
    return candidates(plain, [cause for cause in causes_of(plain.rig, plain) if cause.name in ASKED])


def test_both_causes_that_are_there_are_taken_at_once(plain: Fit, pool: list[Candidate]) -> None:
    wider = many_at_once(plain, pool)
    assert wider is not None
    assert set(wider.rig.effects) == set(HIDDEN)
    for cause, size in HIDDEN.items():
        for key, value in size.items():
            name = f"{cause.label}.{key}"
            assert float(wider.values[name]) == pytest.approx(value, abs=4.0 * wider.value_sd(name))


def test_with_one_of_them_there_is_nothing_to_take_at_once(plain: Fit, pool: list[Candidate]) -> None:
    one = fit_of(plain.rig, plain.observations, OFFSET)
    assert many_at_once(one, [c for c in pool if c.cause != CROSS]) is None


def test_each_is_weighed_beside_those_before_it(plain: Fit, pool: list[Candidate]) -> None:
    """The second by its evidence at a full fit with the first: a drift of the offset has none left."""
    first, second = chosen_one_by_one(plain, pool, LEAST, 2)
    screened = screening(plain, pool)
    assert first.cause == max(screened, key=lambda cause: screened[cause][0])
    beside = fit_of(plain.rig, plain.observations, first.cause)
    weight = beside.weight_over(plain)
    rest = screening(beside, [c.weighed(weight) for c in pool if c.cause != first.cause])
    assert second.cause == max(rest, key=lambda cause: rest[cause][0])
    assert len(chosen_one_by_one(plain, pool, LEAST, 1)) == 1
    assert chosen_one_by_one(plain, pool, 1e6, 12) == []


def test_what_has_its_start_away_from_the_null_is_left_to_other_steps(plain: Fit) -> None:
    far = [c for c in candidates(plain, causes_of(plain.rig, plain)) if not c.is_at_null]
    assert far
    assert many_at_once(plain, far) is None


def test_an_instant_is_found_between_those_of_the_coarse_grid(
    small_rig: Rig, small_session: Session, small_truth: dict[str, float]
) -> None:
    step = Cause("offset_step", "hall")
    instants_h = fit_of(small_rig, small_session.observations).posterior.model.circumstances.instants_h
    since_h = instants_h[4] + 0.4 * (instants_h[5] - instants_h[4])
    rig, readings = small_rig.with_values(small_truth), small_session.observations
    readings = with_wrong(rig, readings, step, {"x_T": 100e-6, "since_h": since_h})
    fit = fit_of(small_rig, with_wrong(rig, readings, CROSS, HIDDEN[CROSS]))
    wider = many_at_once(fit, candidates(fit, [step, CROSS]))
    assert wider is not None
    between = (fit.posterior.model.circumstances.hours - since_h) * (
        fit.posterior.model.circumstances.hours - float(wider.values[f"{step.label}.since_h"])
    )
    assert int((between < 0.0).sum()) <= 1  # readings on the wrong side


def test_columns_of_a_chosen_cause_are_followed_from_then_on(plain: Fit, pool: list[Candidate]) -> None:
    """A copy of what was chosen has no evidence left beside it."""
    best = chosen_one_by_one(plain, pool, LEAST, 1)[0]
    copy = Candidate(
        Cause("sensor_lag", "hall"),
        {},
        best.keys,
        best.units,
        torch.zeros_like(best.shift),
        best.columns,
        best.prior_sd,
    )
    chosen = chosen_one_by_one(plain, [best, copy], LEAST, 2)
    assert len(chosen) == 1
