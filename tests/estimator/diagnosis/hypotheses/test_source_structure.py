"""Where causes of many kinds pile up, another structure of the source is taken in their place if it does better, and only then."""

from __future__ import annotations

import pytest

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses import source_structure
from estimator.diagnosis.hypotheses.candidates import candidates, causes_of
from estimator.diagnosis.hypotheses.columns import Columns
from estimator.diagnosis.hypotheses.search import _SearchState
from estimator.diagnosis.hypotheses.search_record import Addition
from estimator.diagnosis.hypotheses.source_structure import (
    Asked,
    OtherStructures,
    is_pile,
    other_structures,
    structural_causes,
)
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.progress import Pace, unwatched
from estimator.diagnosis.structure.families import families
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong
from tests.estimator.inference.conftest import make_problem

pytestmark = pytest.mark.whole

CORE, HIDDEN, OVAL = (Cause(name, "coil1") for name in ("iron_core", "hidden_winding", "coil_ovality"))
PILE = tuple(Cause(name, "hall") for name in ("axis_gain", "cross_axis", "sensor_offset"))
OFFSET = PILE[2]


def asked(fit: Fit, log_bayes_factor: float, *needed: Cause) -> Asked:
    return Asked(HIDDEN, log_bayes_factor, needed, fit)


@pytest.fixture(scope="module")
def plain(small_rig: Rig, small_session: Session) -> Fit:
    return fit_of(small_rig, small_session.observations.calibration)


def test_more_evidence_by_no_more_causes_is_better(plain: Fit) -> None:
    worse, as_many, more = (
        asked(plain, 99.0),
        asked(plain, 101.0, *PILE[:2]),
        asked(plain, 150.0, *PILE),
    )
    assert OtherStructures(PILE, 100.0, (worse,)).better is None
    assert OtherStructures(PILE, 100.0, (more, worse)).better is None
    assert OtherStructures(PILE, 100.0, (more, as_many, worse)).better is as_many


def test_one_kind_at_many_places_is_no_pile() -> None:
    six_offsets = [Cause("sensor_offset", f"probe{i}") for i in range(6)]
    assert not is_pile(six_offsets, 1)
    assert is_pile([*six_offsets, CORE], 1)


def test_effects_say_themselves_that_they_are_other_structures(plain: Fit) -> None:
    assert {CORE, HIDDEN, OVAL} < set(structural_causes(plain, Limits()))
    assert not set(PILE) & set(structural_causes(plain, Limits()))


@pytest.fixture
def search_of_imitation(
    monkeypatch, small_rig: Rig, small_session: Session, small_truth: dict[str, float]
) -> tuple[_SearchState, Fit]:
    """Readings with a core in the bore and an offset: a search from the plain fit, and a fit where a pile stands for both."""
    monkeypatch.setattr(source_structure, "structural_causes", lambda base, limits: [OVAL, CORE])
    rig = small_rig.with_values(small_truth)
    readings = with_wrong(rig, small_session.observations, CORE, {"share": 0.3})
    readings = with_wrong(rig, readings, OFFSET, {"x_T": 100e-6}).calibration
    base = fit_of(small_rig, readings)
    pool = candidates(base, [CORE, OVAL, *PILE])
    columns = Columns(base, causes_of(small_rig, base), pool, families(base))
    state = _SearchState(columns, lambda words: None, Limits())
    pile = fit_of(small_rig, readings, *PILE)
    state.additions = [Addition(PILE, pile)]
    return state, pile


def test_other_structure_and_what_it_leaves_needed_replace_a_pile(search_of_imitation) -> None:
    state, pile = search_of_imitation
    fit = state._with_other_structure(pile)
    found = state.other_structures
    assert found.pile == PILE
    assert [one.cause for one in found.asked] == [CORE, OVAL]
    assert found.better.needed == (OFFSET,)
    assert fit.rig.effects == (CORE,)
    assert float(fit.values[f"{CORE.label}.share"]) == pytest.approx(0.3, abs=0.1)
    assert state.dropped == list(PILE)
    assert [step.taken for step in state.steps] == [CORE]
    assert state.steps[0].taken_fit is fit
    assert state.additions_in(fit) == (Addition((CORE,), fit),)


def test_a_pile_stays_where_no_other_structure_is_asked(search_of_imitation, monkeypatch) -> None:
    state, pile = search_of_imitation
    monkeypatch.setattr(source_structure, "structural_causes", lambda base, limits: [])
    assert state._with_other_structure(pile) is pile
    assert state.additions == [Addition(PILE, pile)]


def test_a_structure_that_cannot_explain_what_is_worth_a_start_is_not_followed(plain: Fit) -> None:
    """Nothing is hidden here, so it gains little; a climb that is to reach more ends at its first step."""
    followed, given_up = (source_structure._best_alone(plain, OVAL, worth) for worth in (0.0, 1e6))
    assert followed.optimum.n_iterations > given_up.optimum.n_iterations == 1
    assert float(given_up.optimum.log_posterior) < float(followed.optimum.log_posterior)


@pytest.fixture(scope="module")
def one_of_two() -> tuple[Rig, Observations]:
    """A rig of two coils, and readings with current in the first alone."""
    two = """{c1: {radius_mm: {prior: {normal: {mean: 45, sd: 2}}}, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 4},
      c2: {radius_mm: 30, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 4, world_from_coil: {z_mm: -50}}}"""
    problem = make_problem(
        two, "{hall: {noise_uT: {prior: {log_normal: {median: 20, relative_sd: 0.5}}}, carried_by: stage}}"
    )
    readings = problem.observations
    return problem.rig, readings.rows(readings.current_A[:, 1] == 0.0)


def test_a_coil_without_current_has_no_other_structure(one_of_two) -> None:
    """It is not fitted, and not told as one that explains as much."""
    rig, readings = one_of_two
    base, pile = fit_of(rig, readings), fit_of(rig, readings, *PILE)
    limits = Limits()
    causes = structural_causes(base, limits)
    found = other_structures(base, pile, candidates(base, causes), limits, Pace("structures", unwatched))
    asked = {one.cause for one in found.asked}
    assert Cause("hidden_winding", "c1") in asked
    windings = ("hidden_winding", "winding_misstated", "iron_core", "coil_ovality")
    assert not {*causes, *asked} & {Cause(name, "c2") for name in windings}
    assert Cause("cross_magnetisation", "c2") in asked  # a core there answers the other coil


def test_a_coil_whose_supply_has_an_offset_may_be_wound_otherwise(one_of_two) -> None:
    rig, readings = one_of_two
    leaking = fit_of(rig, readings, Cause("current_offset", "c2"))
    assert Cause("hidden_winding", "c2") in structural_causes(leaking, Limits())
