"""Columns of causes are weighted like the readings at every step of a search; and a search ends where it should."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from estimator.diagnosis import policy
from estimator.diagnosis.hypotheses import search
from estimator.diagnosis.hypotheses.candidates import candidates, causes_of
from estimator.diagnosis.hypotheses.columns import Columns
from estimator.diagnosis.hypotheses.step import take_step
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.progress import unwatched
from estimator.diagnosis.structure.discrepancy import discrepancy
from estimator.diagnosis.structure.families import families
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong
from tests.hidden.session import draw_session

pytestmark = pytest.mark.whole

GAIN, OFFSET = Cause("axis_gain", "hall"), Cause("sensor_offset", "hall")


def searched(fit, limits=None, tell=lambda words: None, on_progress=unwatched):
    limits = limits or Limits()
    return search.search(Columns.at(fit, limits), tell, limits, on_progress)


@pytest.fixture(scope="module")
def noisy_and_quiet(small_rig: Rig, small_session: Session):
    """The same readings fitted with the noise as it is, 5 uT, and with a quarter of it."""
    readings = small_session.observations.calibration
    return [fit_of(small_rig.with_values({"hall.noise_T": noise_T}), readings) for noise_T in (5e-6, 1.25e-6)]


def test_columns_taken_at_one_fit_and_weighed_for_another_are_those_of_the_other(noisy_and_quiet):
    noisy, quiet = noisy_and_quiet
    (ours,), (theirs,) = (candidates(fit, [GAIN]) for fit in noisy_and_quiet)
    weighed = ours.weighed(quiet.weight_over(noisy))
    assert weighed.columns.norm() == pytest.approx(4.0 * float(ours.columns.norm()), rel=1e-9)
    torch.testing.assert_close(
        weighed.columns, theirs.columns, rtol=0.01, atol=0.01 * float(theirs.columns.max())
    )


def test_a_step_of_the_search_is_given_weighed_columns(noisy_and_quiet, monkeypatch):
    noisy, quiet = noisy_and_quiet
    pool = candidates(noisy, [GAIN])
    given = []

    def spy(fit, pool, smooth, *others):
        given.append((pool, smooth))
        return take_step(fit, pool, smooth, *others)

    monkeypatch.setattr(search, "take_step", spy)
    smooth = families(noisy)
    columns = Columns(noisy, causes_of(noisy.rig, noisy), pool, smooth)
    search._SearchState(columns, lambda words: None, Limits()).step(quiet)
    ((candidate,), curves) = given[0]
    torch.testing.assert_close(candidate.columns, 4.0 * pool[0].columns)
    for before, after in zip(smooth, curves, strict=True):  # amplitudes stay in units of the noise
        torch.testing.assert_close(after.columns, before.columns)


def test_a_curve_keeps_its_size_in_units_of_the_noise(noisy_and_quiet):
    noisy, quiet = noisy_and_quiet
    whole = discrepancy(noisy, families(noisy))
    torch.testing.assert_close(whole.weighed(quiet.weight_over(noisy)).columns, whole.columns)


def test_a_search_ends_at_the_most_causes_with_a_step_that_takes_nothing(
    small_rig, small_session, small_truth
):
    rig = small_rig.with_values(small_truth)
    readings = with_wrong(rig, small_session.observations, OFFSET, {"x_T": 100e-6, "z_T": -150e-6})
    readings = with_wrong(rig, readings, GAIN, {"x": 0.1})
    told = []
    result = searched(fit_of(small_rig, readings.calibration), Limits(most_causes=1), told.append)
    taken = [step.taken for step in result.steps]
    assert taken[-1] is None
    assert tuple(taken[:-1]) == result.final.rig.effects
    assert len(result.final.rig.effects) == 1
    assert result.ended_early == "the number of causes is limited to 1"
    assert told[-1].endswith("has enough evidence too, but the number of causes is limited to 1")


def test_a_search_without_time_takes_nothing_and_says_why(small_rig, small_session, small_truth):
    rig = small_rig.with_values(small_truth)
    readings = with_wrong(rig, small_session.observations, OFFSET, {"x_T": 100e-6}).calibration
    result = searched(fit_of(small_rig, readings), Limits(minutes=0.0))
    assert result.final.rig.effects == ()
    assert all(hypothesis.fit is None for hypothesis in result.steps[-1].hypotheses if hypothesis.cause)
    assert result.ended_early == "its time of 0 min was over"
    assert result.remainder.log_bayes_factor > 10.0


def test_noise_ends_the_search_of_a_pile(small_rig, small_session, small_truth, monkeypatch):
    """It is asked where no other cause suffices, and with more noise fewer do: the last step fits nothing, and says what is left."""
    rig = small_rig.with_values(small_truth)
    fit = fit_of(small_rig, with_wrong(rig, small_session.observations, OFFSET, {"x_T": 100e-6}).calibration)
    columns = Columns(fit, causes_of(fit.rig, fit), candidates(fit, [OFFSET, GAIN]), families(fit))
    state = search._SearchState(columns, lambda words: None, Limits())
    noise = search._alone_in_step(Cause("outliers", "hall"), 20.0, fit)
    state.steps = [noise]
    assert state.step(fit).taken == OFFSET
    monkeypatch.setattr(state, "is_piled", lambda fit: True)
    last = state.step(fit)
    assert last.taken is None
    assert not any(one.fit for one in last.hypotheses)
    assert last.remainder.log_bayes_factor > 10.0
    state.steps = [search._alone_in_step(GAIN, 20.0, fit)]
    assert state.step(fit).taken == OFFSET


def test_a_step_counts_its_fits_and_never_promises_too_few(small_rig, small_session, small_truth):
    rig = small_rig.with_values(small_truth)
    readings = with_wrong(rig, small_session.observations, OFFSET, {"x_T": 100e-6}).calibration
    told = []
    result = searched(fit_of(small_rig, readings), Limits(most_causes=0), on_progress=told.append)
    (step,) = result.steps
    n_fitted = sum(hypothesis.fit is not None for hypothesis in step.hypotheses)
    assert n_fitted > 1
    assert [progress.n_fitted for progress in told] == list(range(n_fitted + 1))
    assert all(progress.most >= n_fitted for progress in told)
    assert told[-1].most == n_fitted
    assert told[0].left_s is None
    assert {progress.what for progress in told} == {"step 1"}


def test_a_search_ends_with_the_same_sets_whether_or_not_quiet_causes_are_fitted(
    small_rig, small_session, small_truth, monkeypatch
):
    """Decision 64: the step that takes nothing is quiet."""
    rig = small_rig.with_values(small_truth)
    readings = with_wrong(rig, small_session.observations, OFFSET, {"x_T": 100e-6}).calibration
    fit = fit_of(small_rig, readings)

    def outcome():
        found = searched(fit)
        sets = [(step.taken, {one.name for one in step.credible}) for step in found.steps]
        n_fitted = sum(one.fit is not None for step in found.steps for one in step.hypotheses)
        return (sets, found.final.rig.effects), n_fitted

    spared, n_spared = outcome()
    monkeypatch.setattr(policy, "MOST_GAINED_IN_FULL", math.inf)
    everything, n_everything = outcome()
    assert spared == everything
    assert n_spared < n_everything


def searched_session(causes: tuple[str, ...], sigma: float, folder: Path) -> search.Search:
    """Search of a session of one sensor with hidden causes, by independent code."""
    draw_session(150_010, causes, sigma, "paper").write(folder)
    session = read_readings_csv(folder / "readings.csv", load_rig(folder / "rig.yaml"))
    return searched(fit_of(session.rig, session.observations.calibration))


def test_two_causes_take_the_place_of_one_with_many_numbers(tmp_path: Path) -> None:
    """An exchanged sensor has gains and zeros of its own from an instant on: for a drift and a wrong gain it is the best single cause."""
    found = searched_session(("background_drift", "element_displacement"), 8.0, tmp_path)
    assert "sensor_exchanged" in {cause.name for cause in found.dropped}
    sets = [{one.name.partition("[")[0] for one in step.credible} for step in found.steps if step.taken]
    assert len(sets) == 2
    assert any("background_drift" in names for names in sets)
    assert any("element_displacement" in names for names in sets)


@pytest.mark.slow
def test_one_cause_with_many_numbers_keeps_its_place_where_it_is_the_truth(tmp_path: Path) -> None:
    found = searched_session(("sensor_exchanged",), 20.0, tmp_path)
    assert [cause.name for cause in found.final.rig.effects] == ["sensor_exchanged"]
