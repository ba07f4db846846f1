"""A correction replaces the fits where it predicts unseen readings better, and leaves them where it does not."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.hypotheses.columns import Columns
from estimator.diagnosis.hypotheses.search import search
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.outcome import Outcome
from estimator.diagnosis.validation import validation_scores
from estimator.rig.rig import Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.corrections.test_choice import with_dipole
from tests.estimator.diagnosis.small_fits import fit_of, unheard

pytestmark = pytest.mark.whole


def test_unseen_readings_keep_a_correction_or_drop_it_with_its_covariance(
    small_rig: Rig, small_session: Session
) -> None:
    """Those that keep it hold the dipole that the fitted ones hold; those that drop it hold the opposite one."""
    clean, coil_z_m = small_session.observations, small_session.truth["coil1.world_from_coil0.z_m"]
    flawed = with_dipole(clean, coil_z_m)
    opposite = clean.with_field(2.0 * clean.field_sensor_T - flawed.field_sensor_T)
    plain = fit_of(small_rig, flawed.calibration)
    limits = Limits(most_causes=0)
    found_nothing = search(Columns.at(plain, limits), unheard, limits)
    before = Outcome.of(plain, found_nothing, (), is_record_wrong=False)
    kept, dropped = (
        before.corrected(unseen.validation, torch.device("cpu"), unheard, Limits())
        for unseen in (flawed, opposite)
    )
    assert kept.correction.is_taken
    assert kept.after is kept.correction.final
    assert kept.after.rig.corrections
    assert not dropped.correction.is_taken
    assert "unseen" in dropped.correction.refusal
    assert (dropped.extended, dropped.after) == (before.extended, before.after)
    for outcome, unseen in ((kept, flawed), (dropped, opposite)):
        scores = validation_scores(outcome.after, unseen.validation, outcome.widening.covariance)
        assert outcome.widening.fit is outcome.after
        assert outcome.improvement.after.elpd == pytest.approx(scores.elpd)
    assert kept.correction.gain.after is kept.improvement.after
    assert kept.improvement.elpd_difference > 0.0
