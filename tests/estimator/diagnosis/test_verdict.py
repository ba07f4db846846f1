"""Verdicts, names and fits of answers whose draws are made by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.naming import named_by
from estimator.diagnosis.mixture.scatter import BesideScatter
from estimator.diagnosis.mixture.slots import Slots
from estimator.diagnosis.outcome import Outcome
from estimator.diagnosis.verdict import Alternative, NamedCause, Verdict
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.mixture.hand_made import said
from tests.estimator.diagnosis.small_fits import answered, fit_of

pytestmark = [pytest.mark.whole, pytest.mark.usefixtures("names_are_right")]

OFFSET, GAIN = Cause("sensor_offset", "hall"), Cause("axis_gain", "hall")
CROSS, ROOM = Cause("cross_axis", "hall"), Cause("background_field", "room")
WANDERS, STEPS = Cause("zero_wanders", "hall"), Cause("gain_steps", "hall")  # which no list holds


@pytest.fixture(scope="module")
def asked(of_nothing: Answer) -> Asked:
    return of_nothing.first


def outcome_of(answer: Answer, *mistakes: NamedCause, scattering: tuple[NamedCause, ...] = ()) -> Outcome:
    return Outcome.of(
        answer.plain, BesideScatter(answer, scattering), mistakes, is_record_wrong=bool(mistakes)
    )


def test_without_causes_and_structure_nothing_was_found(asked):
    outcome = outcome_of(said(asked, {(): 100}))
    assert (outcome.verdict, outcome.named) == (Verdict.NOTHING_FOUND, [])
    assert outcome.extended is outcome.answer.plain


@pytest.mark.parametrize("causes", [(OFFSET,), (OFFSET, GAIN)], ids=len)
def test_causes_alone_in_their_sets_are_named_and_the_rig_is_extended_by_them(asked, causes):
    outcome = outcome_of(said(asked, {causes: 97, (): 3}))
    assert outcome.verdict is Verdict.NAMED
    assert {named.cause for named in outcome.named} == set(causes)
    assert [named.probability for named in outcome.named] == pytest.approx([0.97] * len(causes))
    assert set(outcome.extended.rig.effects) == set(causes)
    assert outcome.after is outcome.extended


def test_one_cause_with_an_alternative_makes_the_verdict_indistinguishable(asked):
    answer = said(asked, {(OFFSET, GAIN): 95, (): 5}, [{GAIN: 0.6, CROSS: 0.4}])
    outcome = outcome_of(answer)
    assert outcome.verdict is Verdict.INDISTINGUISHABLE
    named = {each.cause: each for each in outcome.named}
    assert set(named) == {OFFSET, GAIN}
    assert named[OFFSET].is_alone
    assert named[GAIN].probability == pytest.approx(0.6 * 0.95)
    (other,) = named[GAIN].alternatives
    assert (other.cause, other.probability) == (CROSS, pytest.approx(0.4 * 0.95))
    assert named[GAIN].p_not_in_library == pytest.approx(0.05)


@pytest.mark.parametrize(("share", "verdict"), [(0.1, Verdict.NAMED), (0.3, Verdict.INDISTINGUISHABLE)])
def test_a_name_beside_something_unknown_is_not_alone_and_a_faint_doubt_leaves_it_so(asked, share, verdict):
    answer = said(asked, {(GAIN,): 97, (): 3}, [{GAIN: 1.0 - share, STEPS: share}])
    (named,) = named_by(answer)
    assert named.p_not_in_library == pytest.approx(1.0 - 0.97 * (1.0 - share))
    assert outcome_of(answer).verdict is verdict


def test_what_is_rather_unlisted_has_no_name(asked):
    answer = said(asked, {(STEPS,): 97, (): 3}, [{GAIN: 0.3, STEPS: 0.7}])
    outcome = outcome_of(answer)
    assert (outcome.verdict, outcome.named) == (Verdict.UNEXPLAINED, [])
    assert outcome.extended is answer.plain


def test_a_departure_beside_a_name_is_partly_explained_and_alone_unexplained(asked):
    beside, alone = (outcome_of(said(asked, {(*causes, WANDERS): 98, causes: 2})) for causes in ((GAIN,), ()))
    assert beside.verdict is Verdict.PARTLY_EXPLAINED
    assert [named.cause for named in beside.named] == [GAIN]
    assert alone.verdict is Verdict.UNEXPLAINED
    assert alone.named == []


def test_a_cause_that_is_not_sure_enough_leaves_something_and_a_faint_one_nothing(asked):
    probable = outcome_of(said(asked, {(GAIN,): 80, (): 20}))
    assert (probable.verdict, probable.named) == (Verdict.UNEXPLAINED, [])
    faint = outcome_of(said(asked, {(GAIN,): 40, (): 60}))
    assert (faint.verdict, faint.named) == (Verdict.NOTHING_FOUND, [])


def with_slots(asked: Asked, n: int) -> Asked:
    """The same with so many slots."""
    return replace(asked, slots=Slots(asked.slots.products, asked.slots.noise, n))


def test_where_all_slots_are_full_and_more_is_there_nothing_is_named(of_two_causes):
    """A gain and an offset are there, and fill none of the slots."""
    full = outcome_of(said(with_slots(of_two_causes.first, 2), {(CROSS, WANDERS): 100}))
    assert (full.verdict, full.named) == (Verdict.UNEXPLAINED, [])
    first = of_two_causes.first
    strong = said(with_slots(first, 2), {(GAIN, WANDERS): 100})
    further = first.slots.products.beside(strong.asked.leading, strong.asked.noise).max()
    assert further < strong.beside_item(strong.item_of(GAIN)).log_bayes_factor([GAIN]) < 2.0 * further
    assert strong.is_full
    assert strong.stated == ()  # though the gain is there: the offset could imitate half of it
    spare = outcome_of(said(first, {(CROSS, WANDERS): 100}))
    assert [named.cause for named in spare.named] == [CROSS]


def test_all_that_was_asked_for_has_names_where_no_more_would_be_there(asked):
    """As where one cause alone is asked for: that it fills its slot does not say that more is wrong."""
    one = with_slots(asked, Limits(1).n_slots(asked.expansion.plain.rig))
    assert [named.cause for named in named_by(said(one, {(OFFSET,): 100}))] == [OFFSET]


def test_mistakes_of_the_record_alone_are_named_unless_others_do_as_well(asked):
    nothing = said(asked, {(): 100})
    swapped = Cause("axes_swapped", "hall")
    mistake = NamedCause.among({swapped: 0.0}, 300.0)
    twin = NamedCause.among({swapped: 0.0, Cause("left_handed", "record"): -0.5}, 300.0)
    assert outcome_of(nothing, mistake).verdict is Verdict.NAMED
    assert outcome_of(nothing, twin).verdict is Verdict.INDISTINGUISHABLE
    assert outcome_of(said(asked, {(WANDERS,): 100}), mistake).verdict is Verdict.UNEXPLAINED


def test_causes_of_scatter_are_named_beside_the_others(asked):
    jitter = NamedCause(Cause("position_jitter", "arm1"), 0.97, (), 30.0)
    outcome = outcome_of(said(asked, {(GAIN,): 100}), scattering=(jitter,))
    assert outcome.verdict is Verdict.NAMED
    assert [named.cause for named in outcome.named] == [GAIN, jitter.cause]


def test_alternative_says_what_the_readings_should_tell_of_it(small_rig, of_two_causes):
    """Exact twins are never told apart; for other causes the residuals hold the expected evidence, but for noise."""
    slots = [{OFFSET: 0.4, ROOM: 0.35, CROSS: 0.25}]
    (named, _) = sorted(
        named_by(said(of_two_causes.first, {(OFFSET, GAIN): 100}, slots)), key=lambda one: one.cause != OFFSET
    )
    assert named.cause == OFFSET
    twin, other = named.alternatives
    assert (twin.cause, other.cause) == (ROOM, CROSS)
    assert twin.expected_log_evidence == pytest.approx(0.0, abs=1e-3)
    readings = of_two_causes.plain.observations
    fits = {cause: fit_of(small_rig, readings, GAIN, cause) for cause in (OFFSET, CROSS)}
    square = {cause: float(fit.residual.square().sum()) for cause, fit in fits.items()}
    worse = 0.5 * (square[CROSS] - square[OFFSET])
    assert other.expected_log_evidence == pytest.approx(worse, rel=0.05)


def test_evidence_of_a_name_is_that_of_a_full_fit(small_rig, of_two_causes):
    """Beside the other cause; Laplace's evidence of the fit has the stated width, the item its own."""
    named = {each.cause: each for each in named_by(of_two_causes)}
    readings = of_two_causes.plain.observations
    both, one = fit_of(small_rig, readings, OFFSET, GAIN), fit_of(small_rig, readings, OFFSET)
    assert named[GAIN].log_bayes_factor == pytest.approx(both.log_evidence - one.log_evidence, abs=5.0)
    assert named[GAIN].log_bayes_factor > 10.0


def test_evidence_of_a_name_is_not_taken_beside_its_own_twin(of_two_causes):
    """The twin leads, and the other is drawn as often: beside it the name would explain nothing."""
    answer = said(of_two_causes.first, {(ROOM, GAIN): 100}, [{OFFSET: 0.6, ROOM: 0.4}])
    named = {each.cause: each for each in named_by(answer)}
    assert named[OFFSET].log_bayes_factor > 50.0
    comparison = next(each for each in answer.comparisons if OFFSET in each.taken)
    of_twins = {h.cause: h.log_bayes_factor for h in comparison.hypotheses if h.cause in (OFFSET, ROOM)}
    assert of_twins[OFFSET] == pytest.approx(of_twins[ROOM], abs=1.0)


def test_a_number_that_is_pulled_far_from_its_prior_is_unexplained(small_rig, small_session):
    far = small_rig.parameters["coil1.radius_m"]
    moved = replace(far, prior=Normal(far.value - 8e-3, 1e-3), value=far.value - 8e-3)
    fit = fit_of(small_rig.with_parameters([moved]), small_session.observations.calibration)
    outcome = outcome_of(said(answered(fit, n_pairs=0).first, {(): 100}))
    assert outcome.pull.name == "coil1.radius_m"
    assert outcome.verdict is Verdict.UNEXPLAINED


def test_more_readings_weigh_the_causes_of_a_set():
    named = NamedCause(GAIN, 0.6, (Alternative(CROSS, 0.2, 1.0), Alternative(ROOM, 0.1, 1.0)), 30.0, 0.1)
    weighed = named.weighed_by({GAIN: -12.0, CROSS: -10.0, ROOM: -10.0})
    total = 0.6 * math.exp(-2.0) + 0.2 + 0.1
    assert (weighed.cause, weighed.p_not_in_library) == (CROSS, 0.1)
    assert weighed.probability == pytest.approx(0.9 * 0.2 / total)
    assert [each.cause for each in weighed.alternatives] == [ROOM, GAIN]
    assert named.weighed_by({GAIN: 0.0, CROSS: -20.0, ROOM: -20.0}).alternatives == ()
