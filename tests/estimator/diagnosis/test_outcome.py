"""A correction replaces the fits where it predicts unseen readings better, and leaves them where it does not."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.diagnosis import policy
from estimator.diagnosis.corrections.result import Correction
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.scatter import BesideScatter
from estimator.diagnosis.outcome import Outcome
from estimator.diagnosis.validation import validation_scores
from estimator.diagnosis.verdict import Verdict
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.small_fits import unheard
from tests.estimator.diagnosis.unknown_source import with_dipole

pytestmark = pytest.mark.whole

GAIN = Cause("axis_gain", "hall")


@pytest.fixture(scope="module")
def before(of_dipole: Answer) -> Outcome:
    """What is said where every name is known to be an imitation: a part of the arm that is magnetised looks like the dipoles."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(policy, "IMITATION", (-50.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        answer = replace(of_dipole)
        return Outcome.of(of_dipole.plain, BesideScatter(answer, ()), (), is_record_wrong=False)


def test_unseen_readings_keep_a_correction_or_drop_it_with_its_covariance(before, dipole, small_session):
    """Those that keep it hold the dipole that the fitted ones hold; those that drop it hold the opposite one."""
    assert before.verdict is Verdict.UNEXPLAINED
    opposite = with_dipole(small_session, -1.0)
    kept, dropped = (before.corrected(unseen.validation, Limits(), unheard) for unseen in (dipole, opposite))
    assert kept.correction is not None
    assert dropped.correction is not None
    assert kept.correction.is_taken
    assert kept.after is kept.correction.final
    assert kept.after.rig.corrections
    assert not dropped.correction.is_taken
    assert "unseen" in dropped.correction.refusal
    assert (dropped.extended, dropped.after) == (before.extended, before.after)
    for made, unseen in ((kept, dipole), (dropped, opposite)):
        assert made.widening is not None
        assert made.improvement is not None
        scores = validation_scores(made.after, unseen.validation, made.widening.covariance)
        assert made.widening.fit is made.after
        assert made.improvement.after.elpd == pytest.approx(scores.elpd)
    assert kept.improvement is not None
    assert kept.correction.gain is not None
    assert kept.correction.gain.after is kept.improvement.after
    assert kept.improvement.elpd_difference > 0.0


def test_without_corrections_intervals_of_the_rig_hold_the_truth(before, dipole, small_session):
    """The fit of the rig as described is several of its own standard deviations off, for it makes up for the dipoles."""
    widened = before.widened(dipole.validation)
    assert widened.after is before.after
    assert widened.correction is None
    assert widened.widening is not None
    assert small_session.truth is not None
    fit, factors = widened.after, widened.widening.factors
    off_sd = {
        name: abs(float(fit.values[name]) - value) / fit.value_sd(name)
        for name, value in small_session.truth.items()
    }
    assert max(off_sd.values()) > 3.0
    assert all(off / factors[name] < HALF_WIDTH_90 for name, off in off_sd.items())


def test_a_cause_that_accounts_for_next_to_nothing_loses_its_name_where_it_should_move_unseen_readings(
    of_two_causes, two_causes, monkeypatch
):
    """Readings that something else moves by 3 mT say nothing of a gain of 5 % and a zero of 100 uT, nor of a range that clips one."""
    said = Outcome.of(of_two_causes.plain, BesideScatter(of_two_causes, ()), (), is_record_wrong=False)
    unseen = two_causes.validation
    with_budget = said.checked_by(unseen, seed=1)
    assert with_budget.budget is not None
    assert (with_budget.verdict, with_budget.named) == (said.verdict, said.named)
    moved_T = unseen.field_sensor_T + torch.tensor([0.0, 3e-3, 0.0], dtype=torch.float64)
    nothing = said.checked_by(unseen.with_field(moved_T), seed=1)
    assert (nothing.verdict, nothing.named) == (Verdict.UNEXPLAINED, [])
    monkeypatch.setattr(Answer, "share_moved", lambda self, cause: 1.0 / 375.0)
    assert said.checked_by(unseen.with_field(moved_T), seed=1).named == said.named


def test_a_zero_along_one_axis_moves_a_third_of_the_components(of_two_causes):
    """Less what the numbers of the rig can follow of it."""
    (zero,) = (named.first_listed for named in of_two_causes.stated if named.first_listed != GAIN)
    assert of_two_causes.share_moved(zero) == pytest.approx(1.0 / 3.0, abs=0.15)


def test_a_cause_of_which_the_corrections_leave_nothing_loses_its_name(
    of_two_causes, two_causes, monkeypatch
):
    said = Outcome.of(of_two_causes.plain, BesideScatter(of_two_causes, ()), (), is_record_wrong=False)
    (replaced,) = (each.cause for each in said.named if each.cause == GAIN)
    monkeypatch.setattr(Fit, "has_nothing_of", lambda self, cause: cause == replaced)
    with_it = said.checked_by(two_causes.validation, seed=1)
    assert with_it.named == said.named, "nothing was corrected"
    corrected = replace(said, correction=Correction(said.after, (), {}, "", said.after))
    without = corrected.checked_by(two_causes.validation, seed=1)
    assert [each.cause for each in without.named] == [c.cause for c in said.named if c.cause != replaced]
    assert without.verdict is Verdict.PARTLY_EXPLAINED


def test_a_rig_that_predicts_worse_does_not_replace_the_one_described(
    of_two_causes, two_causes, small_session
):
    """Unseen readings without the causes."""
    said = Outcome.of(of_two_causes.plain, BesideScatter(of_two_causes, ()), (), is_record_wrong=False)
    confirmed = said.checked_by(two_causes.validation, seed=1)
    assert (confirmed.verdict, confirmed.named) == (said.verdict, said.named)
    assert confirmed.improvement is not None
    assert confirmed.improvement.is_significant
    refused = said.checked_by(small_session.observations.validation, seed=1)
    assert refused.verdict is Verdict.UNEXPLAINED
    assert not refused.named
    assert refused.after is refused.extended is of_two_causes.plain
    assert refused.improvement is not None
    assert refused.improvement.after.errors.vector_T == refused.improvement.before.errors.vector_T
