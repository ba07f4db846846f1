"""Verdicts of searches put together by hand, and causes that keep their name beside something unknown."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from scipy.special import softmax

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.hypotheses.search_record import Search
from estimator.diagnosis.hypotheses.step import Hypothesis, Step, credible_set
from estimator.diagnosis.structure.discrepancy import Discrepancy
from estimator.diagnosis.structure.families import families
from estimator.diagnosis.verdict import (
    Alternative,
    NamedCause,
    Verdict,
    extended_fit,
    judged,
    named_causes,
    stand_ins,
    verdict_of,
)
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole

OFFSET, GAIN, TILT = Cause("sensor_offset", "hall"), Cause("axis_gain", "hall"), Cause("mount_tilt", "coil1")
BOTH = [OFFSET, GAIN]
CLEAR = 1000.0  # in log evidence: beyond every threshold


@pytest.fixture(scope="module")
def base(small_rig: Rig, small_session: Session) -> Fit:
    return fit_of(small_rig, small_session.observations.calibration)


@pytest.fixture(scope="module")
def both(small_rig: Rig, small_session: Session) -> Fit:
    return fit_of(small_rig, small_session.observations.calibration, OFFSET, GAIN)


def left(log_bayes_factor: float) -> Discrepancy:
    return Discrepancy(log_bayes_factor, "time", {"time": log_bayes_factor}, 1.0, torch.zeros(3, 1).double())


def step(taken: Cause | None, evidence: dict[Cause, float], structure: float = -3.0) -> Step:
    """One step: causes of a credible set with their log Bayes factors."""
    credible = tuple(Hypothesis(cause, cause.label, value) for cause, value in evidence.items())
    nothing = (Hypothesis(None, "nothing", 0.0), Hypothesis(None, "unexplained", structure))
    return Step((*credible, *nothing), taken, credible, left(structure))


def search_with(base: Fit, final: Fit, *steps: Step, whole: float = -3.0) -> Search:
    return Search(
        base,
        final,
        steps,
        (),
        (),
        tuple(candidates(base, [OFFSET, GAIN])),
        left(whole),
        tuple(families(final)),
    )


def named(cause: Cause, *others: Cause) -> NamedCause:
    return NamedCause(cause, 0.9, tuple(Alternative(other, 0.1, None) for other in others), 50.0)


LAST = step(None, {})


def test_without_causes_and_structure_nothing_was_found(base):
    assert verdict_of(search_with(base, base, LAST), []) is Verdict.NOTHING_FOUND


def test_cause_alone_in_its_credible_set_is_named(base, both):
    assert verdict_of(search_with(base, both, LAST), [named(OFFSET)]) is Verdict.NAMED
    assert verdict_of(search_with(base, both, LAST), [named(OFFSET), named(GAIN)]) is Verdict.NAMED


def test_one_cause_with_an_alternative_makes_the_verdict_indistinguishable(base, both):
    assert (
        verdict_of(search_with(base, both, LAST), [named(OFFSET), named(GAIN, TILT)])
        is Verdict.INDISTINGUISHABLE
    )


def test_a_name_beside_something_unknown_is_not_alone_and_a_faint_doubt_leaves_it_so(base, both):
    for doubt, verdict in ((0.19, Verdict.NAMED), (0.21, Verdict.INDISTINGUISHABLE)):
        doubtful = replace(named(GAIN), probability=1.0 - doubt, p_not_in_library=doubt)
        assert verdict_of(search_with(base, both, LAST), [named(OFFSET), doubtful]) is verdict


@pytest.mark.parametrize("causes", [[], [named(OFFSET)], [named(OFFSET, GAIN)]])
def test_structure_that_is_left_is_unexplained_whatever_was_named(base, both, causes):
    search = search_with(base, both, step(None, {}, structure=CLEAR))
    assert verdict_of(search, causes) is Verdict.UNEXPLAINED


def test_evidence_for_structure_counts_at_the_last_step_only(base, both):
    search = search_with(base, both, step(OFFSET, {OFFSET: 50.0}, structure=CLEAR), LAST)
    assert verdict_of(search, [named(OFFSET)]) is Verdict.NAMED


def test_several_causes_that_a_flexible_curve_beats_together_are_an_imitation(base, both):
    search = search_with(base, both, LAST, whole=CLEAR)
    assert verdict_of(search, [named(OFFSET), named(GAIN)]) is Verdict.UNEXPLAINED
    assert verdict_of(search, [named(OFFSET)]) is Verdict.NAMED


def test_a_little_evidence_for_structure_changes_nothing(base, both):
    search = search_with(base, both, step(None, {}, structure=1.0), whole=1.0)
    assert verdict_of(search, [named(OFFSET), named(GAIN)]) is Verdict.NAMED


def test_what_explains_no_more_than_nothing_is_no_alternative_however_many_such_there_are():
    """A hundred idle causes hold 11 % of the probability beside one of log evidence 6.7."""
    weak = Hypothesis(GAIN, GAIN.label, 3.0)
    idle = [Hypothesis(Cause("current_gain", f"coil{i}"), f"{i}", 0.0) for i in range(100)]
    taken = Hypothesis(OFFSET, OFFSET.label, 6.7)
    assert credible_set([taken, weak, *idle], OFFSET) == (taken, weak)
    assert credible_set([taken, *idle], None) == (taken,)
    assert idle[99] in credible_set([taken, *idle], idle[99].cause)


def test_probabilities_of_a_step_are_shares_of_evidence_among_its_credible_set(base, both):
    evidence = {OFFSET: 31.0, TILT: 30.2, Cause("background_field", "room"): 28.5}
    search = search_with(base, both, step(OFFSET, evidence), step(GAIN, {GAIN: 12.0}), LAST)
    first, second = named_causes(search, BOTH)
    shares = (1.0 - first.p_not_in_library) * softmax(list(evidence.values()))
    assert (first.cause, first.log_bayes_factor) == (OFFSET, 31.0)
    assert first.probability == pytest.approx(shares[0], rel=1e-12)
    assert [other.cause for other in first.alternatives] == list(evidence)[1:]
    assert [other.probability for other in first.alternatives] == pytest.approx(list(shares[1:]), rel=1e-12)
    assert (second.cause, second.alternatives) == (GAIN, ())
    assert second.probability == 1.0 - second.p_not_in_library


def test_alternative_says_what_the_readings_should_tell_of_it(small_rig, small_session, base):
    """Exact twins are never told apart; for other causes the residuals hold the expected evidence, but for noise."""
    room = Cause("background_field", "room")
    seen = small_session.observations.calibration
    wrong = with_wrong(small_rig, seen, OFFSET, {"x_T": 2e-4, "y_T": -1e-4})
    fits = {cause: fit_of(small_rig, wrong, cause) for cause in (OFFSET, room, GAIN)}
    hypotheses = tuple(Hypothesis(cause, cause.label, 9.0, fit=fit) for cause, fit in fits.items())
    taken = Step(hypotheses, OFFSET, hypotheses, left(-3.0))
    (named_cause,) = named_causes(search_with(base, fits[OFFSET], taken, LAST), BOTH)
    twin, other = named_cause.alternatives
    assert (twin.cause, other.cause) == (room, GAIN)
    assert twin.expected_log_evidence == pytest.approx(0.0, abs=1e-3)
    square = {
        cause: float((fit.residual / fit.whitening_per_T).square().sum()) for cause, fit in fits.items()
    }
    whitening = float(fits[OFFSET].whitening_per_T.mean())
    worse = 0.5 * (square[GAIN] - square[OFFSET]) * whitening**2
    assert other.expected_log_evidence == pytest.approx(worse, rel=0.01)


def test_cause_that_was_dropped_later_is_not_named(base, both):
    search = search_with(base, both, step(TILT, {TILT: 40.0}), step(OFFSET, {OFFSET: 50.0}), LAST)
    assert [named_cause.cause for named_cause in named_causes(search, BOTH)] == [OFFSET]


def test_all_log_odds_charge_every_cause_its_prior(base, both):
    search = search_with(base, both, LAST)
    n_causes = len({candidate.cause for candidate in search.pool})
    gain = both.log_evidence - base.log_evidence
    named_cause = search.log_odds - gain
    assert named_cause < 2.0 * -math.log(n_causes)  # two causes, each one of that many and rarer than nothing
    assert search_with(base, base, LAST).log_odds == 0.0


def test_a_cause_that_a_curve_imitates_has_no_evidence_beside_it_and_one_across_it_keeps_its_own(
    small_rig, small_session, small_truth
):
    rig = small_rig.with_values(small_truth)
    readings = with_wrong(rig, small_session.observations, OFFSET, {"x_T": 100e-6, "z_T": -150e-6})
    fit = fit_of(small_rig, readings.calibration, OFFSET)
    alone = fit.log_evidence_for(OFFSET)
    own = [fit.posterior.coordinates.names.index(f"{OFFSET.label}.{axis}_T") for axis in "xyz"]
    imitation = 1e-3 * fit.jacobian[:, own]  # curves that reach a thousand microtesla
    assert alone > 100.0
    assert fit.log_evidence_for(OFFSET, imitation) < 5.0
    assert fit.log_evidence_for(OFFSET, torch.zeros_like(imitation)) == pytest.approx(alone, rel=1e-9)


def test_the_extended_fit_has_all_that_was_taken_where_something_was_named_and_nothing_where_not(base, both):
    search = search_with(base, both, LAST)
    assert extended_fit(search, [named(OFFSET), named(GAIN)]) is both
    assert extended_fit(search, [named(GAIN)]) is both
    assert extended_fit(search, []) is base


def test_of_a_pile_nothing_is_named(base, both, monkeypatch):
    search = search_with(base, both, step(OFFSET, {OFFSET: CLEAR}), step(GAIN, {GAIN: CLEAR}), LAST)
    monkeypatch.setattr(Search, "source_seems_wrong", True)
    assert judged(search) == (Verdict.UNEXPLAINED, [])


def test_what_was_taken_and_is_not_named_stands_in(base, both):
    search = search_with(base, both, LAST)
    final, base = search.final, search.base
    assert stand_ins(search, [named(OFFSET), named(GAIN)], final) == []
    assert stand_ins(search, [named(GAIN)], final) == [OFFSET]
    assert stand_ins(search, [], base) == []


def test_a_number_that_is_pulled_far_from_its_prior_is_unexplained(small_rig, small_session):
    far = small_rig.parameters["coil1.radius_m"]
    moved = replace(far, prior=Normal(far.value - 8e-3, 1e-3), value=far.value - 8e-3)
    fit = fit_of(small_rig.with_parameters([moved]), small_session.observations.calibration)
    assert verdict_of(search_with(fit, fit, LAST), []) is Verdict.UNEXPLAINED
