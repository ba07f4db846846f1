"""An effect that several sensors have is taken at all of them together, and at no others."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from unittest.mock import patch

import pytest
import torch

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses import several_places
from estimator.diagnosis.hypotheses.candidates import candidates, causes_of
from estimator.diagnosis.hypotheses.columns import Columns
from estimator.diagnosis.hypotheses.screening import in_full, screening
from estimator.diagnosis.hypotheses.search import _SearchState, search
from estimator.diagnosis.hypotheses.search_record import Addition
from estimator.diagnosis.hypotheses.several_places import (
    at_several_places,
    comparison_steps,
    joint_evidence,
    without_idle,
)
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.linear import log_bayes_factor
from estimator.diagnosis.structure.families import families
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text
from tests.estimator.diagnosis.small_fits import fit_of, predicted_T, with_wrong

OFFSETS_T = {
    "one": 80e-6,
    "two": -60e-6,
    "three": 0.0,
    "four": 70e-6,
}  # of four sensors, each at places of its own
OFFSET = {name: Cause("sensor_offset", name) for name in OFFSETS_T}
WITH_IT = {OFFSET[name] for name, size_T in OFFSETS_T.items() if size_T}


@pytest.fixture(scope="module")
def rig(rig_text: str, small_truth) -> Rig:
    sensors = "".join(
        f"  {name}: {{noise_uT: 5, world_from_sensor: {{y_mm: {5 * i}}}}}\n"
        for i, name in enumerate(OFFSETS_T)
    )
    return rig_from_text(rig_text[: rig_text.index("  hall:")] + sensors).with_values(small_truth)


@pytest.fixture(scope="module")
def readings(rig: Rig, small_session):
    known = small_session.observations
    known = replace(known, sensor=torch.arange(len(known)) % len(OFFSETS_T)).calibration
    generator = torch.Generator().manual_seed(3)
    noise_T = 5e-6 * torch.randn(len(known), 3, dtype=torch.float64, generator=generator)
    wrong = known.with_field(predicted_T(rig, known) + noise_T)
    for name, size_T in OFFSETS_T.items():
        wrong = with_wrong(rig, wrong, OFFSET[name], {"x_T": size_T, "y_T": -size_T})
    return wrong


@pytest.fixture(scope="module")
def base(rig: Rig, readings) -> Fit:
    return fit_of(rig, readings)


@pytest.fixture(scope="module")
def pool(rig: Rig, base: Fit):
    asked = [cause for cause in causes_of(rig, base) if cause.name in ("sensor_offset", "axis_gain")]
    return candidates(base, asked)


@pytest.fixture(scope="module")
def wider(base: Fit, pool) -> Fit:
    result = at_several_places(base, pool)
    assert result is not None
    return result


def test_those_that_have_it_are_taken_together_and_the_one_that_has_it_not_is_left_out(wider):
    assert set(wider.rig.effects) == WITH_IT
    for cause in WITH_IT:
        assert float(wider.values[f"{cause.label}.x_T"]) == pytest.approx(OFFSETS_T[cause.place], abs=8e-6)


def test_evidence_of_a_kind_is_that_of_its_best_places(base, pool):
    """Against every subset of the places."""
    offsets = [c for c in pool if c.cause.name == "sensor_offset"]
    values = {}
    for places in (chosen for n in range(1, 5) for chosen in combinations(range(4), n)):
        columns = torch.cat([offsets[i].columns for i in places], dim=1)
        prior_sd = torch.cat([offsets[i].prior_sd for i in places])
        gram = base.projector.gram(columns, columns)
        values[places] = float(log_bayes_factor(gram, columns.T @ base.residual, prior_sd, base.free_noise))
    best = max(values, key=values.__getitem__)
    assert {offsets[i].cause for i in best} == WITH_IT
    value, needed = joint_evidence(base, offsets)
    assert {start.cause for start in needed} == WITH_IT
    assert value == pytest.approx(values[best])


def test_a_cause_that_is_left_at_one_place_only_is_asked_alone(rig, readings, pool):
    assert at_several_places(fit_of(rig, readings, OFFSET["one"], OFFSET["two"]), pool) is None


def test_where_one_cause_does_as_well_it_is_left_to_be_asked_alone(rig, small_session):
    """A field of the room equals an offset of every sensor; the single cause is preferred."""
    known = small_session.observations
    known = replace(known, sensor=torch.arange(len(known)) % len(OFFSETS_T)).calibration
    room = Cause("background_field", "room")
    known = with_wrong(rig, known.with_field(predicted_T(rig, known)), room, {"x_T": 80e-6, "z_T": 60e-6})
    plain = fit_of(rig, known)
    asked = [cause for cause in causes_of(rig, plain) if cause.name in ("sensor_offset", "background_field")]
    assert at_several_places(plain, candidates(plain, asked)) is None


def test_one_of_several_is_compared_with_all_others_as_if_it_alone_were_asked_last(
    rig, readings, base, pool, wider
):
    without = fit_of(rig, readings, OFFSET["one"], OFFSET["four"])
    alone = [c for c in pool if c.cause == OFFSET["two"]]
    value, _, start = screening(without, alone)[OFFSET["two"]]
    in_truth, _ = in_full(without, value, start)
    (step,) = comparison_steps(wider, [OFFSET["two"]], pool, families(base))
    assert step.taken == OFFSET["two"]
    assert step.taken_fit is wider
    leader = step.hypotheses[0]
    assert leader.cause == OFFSET["two"]
    assert leader.log_bayes_factor == pytest.approx(in_truth, rel=0.05)
    assert {hypothesis.cause for hypothesis in step.hypotheses} >= {OFFSET["three"], None}


def test_what_is_there_beside_a_cause_is_no_rival_of_it(rig, readings):
    """A wrong gain that is not taken yet has the same evidence without the offset as with it; a drift of the sensor has not."""
    gain, drift = Cause("axis_gain", "three"), Cause("offset_drift", "two")
    rig = rig.with_fixed(
        ["coil1.radius_m", "coil1.axial_loops"]
    )  # by which one sensor's error reaches another, as by z
    readings = with_wrong(rig, readings, gain, {"x": 0.1, "z": 0.1})
    with_all = fit_of(rig, readings, *WITH_IT)
    pool = candidates(with_all, [gain, drift])
    pool += candidates(fit_of(rig, readings), [OFFSET["two"]])
    (step,) = comparison_steps(with_all, [OFFSET["two"]], pool, families(with_all))
    value = {hypothesis.cause: hypothesis.log_bayes_factor for hypothesis in step.hypotheses}
    beside = screening(with_all, [c for c in pool if c.cause == gain])[gain][0]
    assert value[gain] < 0.5 * beside
    assert value[drift] > 20.0
    assert value[OFFSET["two"]] > value[drift]


def test_a_search_takes_them_in_one_go(base, monkeypatch):
    monkeypatch.setattr(policy, "MOST_CAUSES_REFITTED", 0)  # each is not asked again
    told: list[str] = []
    result = search(Columns.at(base, Limits()), told.append, Limits())
    assert set(result.final.rig.effects) == WITH_IT
    assert [step.taken for step in result.steps[:-1]] == list(result.final.rig.effects)
    assert [set(addition.causes) for addition in result.additions] == [WITH_IT]
    assert result.additions[0].fit.log_evidence > base.log_evidence + 100.0
    assert any(words.startswith("taking ") and "," in words for words in told)


def test_a_search_says_the_same_on_one_core_and_on_several(base, monkeypatch):
    found = []
    for n_cores in (1, 3):
        monkeypatch.setattr("estimator.side_by_side.n_cores", lambda n_cores=n_cores: n_cores)
        found.append(search(Columns.at(base, Limits()), lambda words: None, Limits()))
    one, several = found
    assert several.final.rig == one.final.rig
    for first, second in zip(one.steps, several.steps, strict=True):
        assert [h.name for h in second.hypotheses] == [h.name for h in first.hypotheses]
        values = [h.log_bayes_factor for h in first.hypotheses]
        assert [h.log_bayes_factor for h in second.hypotheses] == pytest.approx(values, rel=1e-6, abs=1e-6)


def test_those_taken_together_are_all_compared_at_the_end(base, monkeypatch):
    monkeypatch.setattr(policy, "MOST_CAUSES_REFITTED", 0)
    compared = []

    def spy(fit, causes, *others):
        compared.append(list(causes))
        return comparison_steps(fit, causes, *others)

    monkeypatch.setattr("estimator.diagnosis.hypotheses.search.comparison_steps", spy)
    result = search(Columns.at(base, Limits()), lambda words: None, Limits())
    assert compared == [list(result.final.rig.effects)]
    assert all(step.discrepancy is not None for step in result.steps)


def test_a_pile_compares_one_of_each_kind_that_was_taken_together(base, readings, rig, pool):
    columns = Columns(base, causes_of(rig, base), pool, families(base))
    state = _SearchState(columns, lambda words: None, Limits(most_causes=10))
    fit = fit_of(rig, readings, *(OFFSET[name] for name in ("one", "four")))
    assert state._taken_together(base, fit) is fit
    assert state.not_compared(fit) == list(fit.rig.effects)
    state.compare_shown(fit)
    first, other = fit.rig.effects
    assert state.not_compared(fit) == [other]
    (expected,) = comparison_steps(fit, [first], columns.pool_at(fit), columns.curves_at(fit))
    shown = next(step for step in state.steps if step.taken == first)
    assert [h.name for h in shown.hypotheses] == [h.name for h in expected.hypotheses]


def test_of_those_taken_together_one_that_another_does_better_than_is_told_at_the_end(rig, small_session):
    """A displaced sensor was taken for displaced elements, which the other sensors have."""
    apart = [Cause("element_displacement", name) for name in ("one", "two", "three")]
    misplaced = Cause("sensor_misplaced", "three")
    known = small_session.observations
    known = replace(known, sensor=torch.arange(len(known)) % 3)
    generator = torch.Generator().manual_seed(4)
    noise_T = 5e-6 * torch.randn(len(known), 3, dtype=torch.float64, generator=generator)
    readings = with_wrong(rig, known.with_field(predicted_T(rig, known) + noise_T), misplaced, {"z_m": 2e-3})
    for cause in apart[:2]:
        readings = with_wrong(rig, readings, cause, {"x_at_z_m": 2e-3, "z_at_z_m": -2e-3, "y_at_x_m": 2e-3})
    base = fit_of(rig, readings)
    asked = [c for c in causes_of(rig, base) if c.name in ("element_displacement", "sensor_misplaced")]
    columns = Columns(base, causes_of(rig, base), candidates(base, asked), families(base))
    state = _SearchState(columns, lambda words: None, Limits(most_causes=10))
    fit = fit_of(rig, readings, *apart)
    state.additions.append(Addition(tuple(apart), fit))
    early = [c for c in columns.pool if c.cause != misplaced]
    state.steps += comparison_steps(fit, apart, early, columns.smooth)
    assert [step.credible[0].cause for step in state.steps] == apart
    state.compare_again(fit, apart, columns.curves_at(fit))
    assert [step.taken for step in state.steps] == apart
    assert [step.credible[0].cause for step in state.steps] == [*apart[:2], misplaced]


def test_of_those_taken_together_one_that_is_not_needed_beside_the_others_goes(base, readings, rig, pool):
    """The comparison is dropped too; one that takes the cause again later is new."""
    columns = Columns(base, causes_of(rig, base), pool, families(base))
    state = _SearchState(columns, lambda words: None, Limits(most_causes=10))
    taken = list(OFFSET.values())
    fit = fit_of(rig, readings, *taken)
    state.additions.append(Addition(tuple(taken), fit))
    state.steps += comparison_steps(fit, taken, pool, columns.smooth)
    fewer = state.revisited(fit)
    assert set(fewer.rig.effects) == WITH_IT
    assert {step.taken for step in state.steps} == WITH_IT
    assert state.dropped == [OFFSET["three"]]
    assert set(state.additions_in(fewer)[0].causes) == WITH_IT


def test_a_cause_that_a_fit_has_shown_to_be_needed_is_not_left_out_again(base, readings, rig, monkeypatch):
    monkeypatch.setattr(policy, "SURELY_NEEDED", math.inf)
    fit = fit_of(rig, readings, *(OFFSET[name] for name in ("one", "four", "two")))
    needed: set[Cause] = set()
    assert without_idle(fit, base, needed) == (fit, [])
    least = min(("one", "four"), key=lambda name: fit.log_evidence_for(OFFSET[name]))
    assert needed == {OFFSET[least]}
    with patch.object(several_places, "fit_rig") as again:
        assert without_idle(fit, base, needed) == (fit, [])
        again.assert_not_called()
