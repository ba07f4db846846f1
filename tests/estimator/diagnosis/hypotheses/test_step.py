"""Which cause a step takes where scatter and structure both explain the readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.diagnosis import policy
from estimator.diagnosis.hypotheses.candidates import candidates, causes_of
from estimator.diagnosis.hypotheses.step import Hypothesis, Step, _choice, is_noise, take_step
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.progress import Pace, unwatched
from estimator.diagnosis.structure.discrepancy import Discrepancy
from estimator.readings.split import pose_blocks
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong


def of(name: str, log_bayes_factor: float) -> Hypothesis:
    return Hypothesis(Cause(name, "here"), name, log_bayes_factor)


@pytest.fixture
def quiet() -> Discrepancy:
    return Discrepancy(0.0, "position", {}, 0.0, torch.zeros(3, 1, dtype=torch.float64))


@pytest.mark.parametrize(
    ("scatter", "curve", "stands", "taken"),
    [
        (60.0, 0.0, False, "noise_grows"),
        (60.0, 0.0, True, "current_compression"),  # something is left of it beside the scatter
        (60.0, 55.0, False, "current_compression"),  # curves explain as much: there is structure
        (25.0, 0.0, False, "current_compression"),  # scatter imitates
        (15.0, 0.0, False, "current_compression"),
    ],
)
def test_scatter_that_imitates_structure_comes_first_only_where_it_leads_by_far(
    scatter: float, curve: float, stands: bool, taken: str, quiet: Discrepancy
) -> None:
    earning = [of("noise_grows", scatter), of("current_compression", 20.0)]
    earning.sort(key=lambda one: -one.log_bayes_factor)
    remainder = replace(quiet, log_bayes_factor=curve)
    choice = _choice(earning, remainder, lambda one, beside: stands)
    assert choice is not None
    assert choice.name == taken


def test_outliers_come_first_where_they_lead_and_a_lone_scatter_is_taken(quiet: Discrepancy) -> None:
    both = [of("outliers", 21.0), of("current_compression", 20.0)]
    assert _choice(both, quiet, lambda one, beside: True) is both[0]
    alone = [of("position_jitter", 10.0)]
    assert _choice(alone, quiet, lambda one, beside: True) is alone[0]
    assert _choice([], quiet, lambda one, beside: True) is None


@pytest.mark.whole
def test_causes_without_shapes_are_fitted_only_where_one_comes_near_and_the_numbers_stay(
    small_rig: Rig, small_session: Session, quiet: Discrepancy, monkeypatch: pytest.MonkeyPatch
) -> None:
    readings = small_session.observations
    offset = Cause("sensor_offset", "hall")
    block = pose_blocks(readings, np.random.default_rng(0))

    def step_of(size_T: float):
        fit = fit_of(small_rig, with_wrong(small_rig, readings, offset, {"x_T": size_T}))
        pool = candidates(fit, causes_of(small_rig, fit))
        return take_step(fit, pool, [], block, Limits(), Pace("a step", unwatched), False, quiet)

    small, large = step_of(2e-6), step_of(200e-6)
    assert small.taken is None
    assert large.taken is not None  # the offset or its twin
    monkeypatch.setattr(policy, "MOST_GAINED_IN_FULL", 100.0)
    screened = {one.name: one for one in small.hypotheses if one.fit is None}
    asked_before = [one for one in step_of(2e-6).hypotheses if one.fit is not None and one.name in screened]
    assert asked_before
    for fitted in asked_before:
        value = screened[fitted.name].log_bayes_factor
        assert value == pytest.approx(fitted.log_bayes_factor, abs=0.1)


@pytest.mark.whole
def test_no_more_causes_are_fitted_than_a_comparison_allows(
    small_rig: Rig, small_session: Session, quiet: Discrepancy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a pile of causes few fits must do; the cause that leads the screening is among them."""
    readings, offset = small_session.observations, Cause("sensor_offset", "hall")
    fit = fit_of(small_rig, with_wrong(small_rig, readings, offset, {"x_T": 200e-6}))
    monkeypatch.setattr(policy, "MOST_FITTED_IN_A_PILE", 1)
    pool, block = candidates(fit, causes_of(small_rig, fit)), pose_blocks(readings, np.random.default_rng(0))

    def step_of(is_piled: bool) -> Step:
        pace = Pace("a step", unwatched)
        return take_step(fit, pool, [], block, Limits(), pace, is_piled, quiet)

    def n_fitted(step: Step) -> int:
        return sum(one.fit is not None and not is_noise(one.cause) for one in step.hypotheses)

    few, many = step_of(is_piled=True), step_of(is_piled=False)
    assert n_fitted(few) == 1 < n_fitted(many)
    assert not any(one.fit for one in few.hypotheses if is_noise(one.cause))
    assert few.taken is not None


@pytest.mark.whole
def test_what_a_fit_had_before_is_fitted_in_full_again_though_the_linear_model_shows_little(
    small_rig: Rig, small_session: Session, quiet: Discrepancy
) -> None:
    fit = fit_of(small_rig, small_session.observations)  # with nothing wrong
    pool = candidates(fit, causes_of(small_rig, fit))
    block = pose_blocks(small_session.observations, np.random.default_rng(0))
    left_out = Cause("axis_gain", "hall")

    def fitted(*more: Cause | None) -> set[Cause | None]:
        step = take_step(fit, pool, [], block, Limits(), Pace("a step", unwatched), False, quiet, None, *more)
        return {hypothesis.cause for hypothesis in step.hypotheses if hypothesis.fit is not None}

    assert left_out not in fitted()
    assert fitted(left_out) == fitted() | {left_out}
