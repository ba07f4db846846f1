"""What corrects predictions without a name: a field of unknown sources is followed, and what no prediction has is only told."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
import torch

from estimator.diagnosis import policy
from estimator.diagnosis.corrections.kinds import kinds_of
from estimator.diagnosis.corrections.result import Correction
from estimator.diagnosis.extension import extended_rig
from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.correcting import corrected
from estimator.diagnosis.mixture.naming import fitted_with_stated
from estimator.diagnosis.mixture.numbers import Numbers
from estimator.diagnosis.posterior import extended_posterior
from estimator.diagnosis.validation import improvement_of, validation_scores
from estimator.diagnosis.widening import Widening
from estimator.effects.use import is_in_field
from estimator.model.room_field import RoomField
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import answered, fit_of
from tests.estimator.diagnosis.unknown_source import CURRENT_A, NOISE_T, with_dipole

pytestmark = pytest.mark.whole

ALIKE_T = (1e-4, 1e-4)
HARMONICS, GAIN = Cause("coil_harmonics", "coil1"), Cause("axis_gain", "hall")


@pytest.fixture(scope="module")
def correction(of_dipole: Answer) -> Correction:
    return corrected(of_dipole, of_dipole.plain, of_dipole.plain, Limits())


def test_unknown_source_beside_the_coil_is_corrected_where_nothing_was_read(of_dipole, correction, dipole):
    assert correction.is_taken
    assert correction.parts[0].cause.name in ("coil_harmonics", "coil_multipoles")
    before, after = (validation_scores(fit, dipole.validation) for fit in (of_dipole.plain, correction.final))
    assert before.errors.vector_T > 3.0 * NOISE_T * 3**0.5
    assert after.errors.vector_T < 1.3 * NOISE_T * 3**0.5
    assert after.coverage90 > 0.8
    assert {part.cause for part in correction.parts} == set(correction.final.rig.corrections)


def test_evidence_of_a_departure_is_that_of_a_full_fit(of_dipole):
    """Of a correction many times the noise; and it predicts as the full fit does."""
    asked, plain = of_dipole.first, of_dipole.plain
    items, beside = asked.dictionary.items, asked.slots.products.beside([], 1.0)
    number = max(
        (i for i, item in enumerate(items) if item.cause == HARMONICS), key=lambda i: float(beside[i])
    )
    item = items[number]
    kind = next(kind for kind in kinds_of(plain) if kind.cause == HARMONICS)
    rig = kind.rig(plain, kind.starts[0], dict(zip(item.keys, item.widths, strict=True)))
    full = fit_rig(rig, plain.observations, plain.values, plain.posterior.model.rules)
    gain = full.log_evidence - plain.log_evidence
    assert gain > 50.0
    assert float(beside[number]) == pytest.approx(gain, rel=0.02)
    sizes, _ = asked.slots.products.sizes([number], 1.0)
    change = asked.expansion.always.rest(asked.dictionary.columns[:, list(item.columns)] @ sizes)
    moved = (full.predicted_T - plain.predicted_T) * plain.whitening_per_T
    left = asked.expansion.always.rest(moved) - change
    assert float(left.norm()) < 0.03 * float(change.norm())


def test_corrected_rig_survives_its_file_and_predicts_the_same(small_rig, of_dipole, correction):
    fit = correction.final
    rig = extended_rig(small_rig, fit)
    again = rig_from_text(rig_text(rig))
    assert again == rig
    assert again.hash == rig.hash
    assert "corrections:" in rig_text(rig)
    points_m = torch.tensor([[0.0, 0.0, 0.01], [0.01, -0.01, 0.0]], dtype=torch.float64)
    current_A = torch.tensor([CURRENT_A], dtype=torch.float64)
    fields_T = [
        RoomField(f.rig, f.values, points_m).field_T(f.values, current_A) for f in (of_dipole.plain, fit)
    ]
    again_T = RoomField(again, fit.values, points_m).field_T(fit.values, current_A)
    torch.testing.assert_close(again_T, fields_T[1])
    assert float((fields_T[1] - fields_T[0]).norm(dim=-1).min()) > NOISE_T


def test_what_leads_at_one_coil_and_at_all_together_is_one_correction_of_that_coil(small_rig, of_dipole):
    """A rig has each amplitude once, or no file could hold it and no posterior be drawn."""
    twice = replace(of_dipole)
    twice.__dict__["beside"] = (*of_dipole.beside, *of_dipole.beside)
    correction = corrected(twice, of_dipole.plain, of_dipole.plain, Limits())
    causes = [part.cause for part in correction.parts]
    assert len(causes) == len(set(causes)) == len(correction.final.rig.corrections)
    rig = extended_rig(small_rig, correction.final)
    assert rig_from_text(rig_text(rig)) == rig


def test_nothing_is_corrected_where_stated_causes_explain_all(of_two_causes):
    extended = fitted_with_stated(of_two_causes)
    assert len(extended.rig.effects) == 2
    correction = corrected(of_two_causes, extended, extended, Limits())
    assert correction.parts == ()
    assert not correction.is_taken
    assert correction.final is extended
    assert correction.words(str) == f"Nothing is corrected: {correction.refusal}."


def test_causes_that_are_not_sure_enough_to_be_stated_correct_by_themselves(
    of_two_causes, two_causes, monkeypatch
):
    """They have no name, but predictions with them are right where those of the bare rig are not."""
    monkeypatch.setattr(policy, "STATED", 1.1)
    unsure, bare = replace(of_two_causes), of_two_causes.plain
    assert not unsure.stated
    assert len(unsure.beside) == 2
    correction = corrected(unsure, bare, bare, Limits())
    assert correction.is_taken
    assert correction.parts == ()
    assert len(correction.final.rig.effects) == 2
    assert "by causes that are not sure enough to be stated." in correction.words(str)
    gain = improvement_of(bare, correction.final, two_causes.validation)
    assert correction.judged_by(gain, ALIKE_T).is_taken
    taking = correction.judged_by(gain, (1e-4, 1.5e-4))
    assert not taking.is_taken
    assert (
        "takes so much from the coil that the field alone would miss them by 150 µT instead of 100 µT"
        in taking.words(str)
    )
    assert gain.after.errors.vector_T < 0.5 * gain.before.errors.vector_T


def test_a_current_that_swings_is_told_with_its_period_and_handed_out_to_no_prediction(
    small_rig, small_session
):
    """Beside it the coil would have another strength than a prediction has."""
    observations = small_session.observations
    hours = (observations.time_s - observations.time_s.min()) / 3600.0
    frequency_per_h = 4.3 / float(hours.max())  # between two of the grid
    swing = 1.0 + 0.05 * torch.sin(2.0 * torch.pi * frequency_per_h * hours)[:, None]
    plain = fit_of(small_rig, observations.with_field(swing * observations.field_sensor_T).calibration)
    correction = corrected(answered(plain), plain, plain, Limits())
    (part, *_) = correction.of_session
    assert part.cause == Cause("current_swings", "coil1")
    told = re.fullmatch(r"with a period of ([\d.]+) s", part.extent)
    assert told is not None
    assert float(told[1]) == pytest.approx(3600.0 / frequency_per_h, rel=0.05)
    assert f"looks like current_swings[coil1] {part.extent}" in correction.words(lambda cause: cause.label)
    assert "current_swings" not in {cause.name for cause in correction.final.rig.corrections}
    assert all(is_in_field(small_rig, part.cause) for part in correction.parts)


def test_a_zero_that_wanders_is_fitted_beside_the_coil_and_not_said_to_correct_predictions(
    small_rig, small_session
):
    """It is no part of the field, yet makes the coil's numbers wrong where it is left out."""
    observations = small_session.observations
    hours = observations.time_s / float(observations.time_s.max())
    zero_T = 60e-6 * torch.stack((torch.sin(7.0 * hours) * hours, 0.0 * hours, torch.cos(5.0 * hours)), dim=1)
    plain = fit_of(small_rig, observations.with_field(observations.field_sensor_T + zero_T).calibration)
    correction = corrected(answered(plain), plain, plain, Limits())
    (part,) = correction.parts
    assert part.cause.name in ("zero_wanders", "room_wanders")
    assert not part.is_predicted
    truth = small_session.truth
    assert truth is not None
    off_sd = [
        max(abs(float(fit.values[name]) - truth[name]) / fit.value_sd(name) for name in truth)
        for fit in (plain, correction.fit)
    ]
    assert off_sd[0] > 5.0
    assert off_sd[1] < 3.5
    assert "Predictions are corrected" not in correction.words(str)


def test_no_correction_is_asked_when_the_time_is_over(of_dipole, correction):
    plain = of_dipole.plain
    over = corrected(of_dipole, plain, plain, Limits(minutes=0.0))
    assert not over.is_taken
    assert over.is_cut_short
    assert over.final is plain
    assert over.words(str) == "Nothing is corrected: its time of 0 min was over."
    assert not correction.is_cut_short


def test_correction_that_predicts_unseen_readings_worse_is_dropped(
    of_dipole, correction, dipole, small_session
):
    """Unseen readings with the opposite dipole refute it; they are the ones that count."""
    plain = of_dipole.plain
    opposite = with_dipole(small_session, -1.0).validation
    assert correction.judged_by(improvement_of(plain, correction.final, dipole.validation), ALIKE_T).is_taken
    dropped = correction.judged_by(improvement_of(plain, correction.final, opposite), ALIKE_T)
    assert not dropped.is_taken
    assert "unseen" in dropped.refusal
    assert dropped.gain is not None


def test_posterior_of_a_corrected_rig_is_drawn_with_its_amplitudes(small_rig, small_session, dipole):
    """The draws are as wide as the widening wants them, and the field is nearly as sure as the readings."""
    count = "coil1.axial_loops"
    known = small_rig.with_values({count: small_session.truth[count]}).with_fixed([count])
    found = answered(fit_of(known, dipole.calibration))
    fit = corrected(found, found.plain, found.plain, Limits()).final
    numbers = Numbers.of(found)
    widening = Widening.of(fit, fit, numbers.names, numbers.about(fit))
    rig = extended_rig(known, fit)
    session = Session(known, dipole, "simulated")
    posterior = extended_posterior(session, rig, widening, seed=1)
    names = {p.name for p in rig.free}
    assert len(names) > 10
    assert set(posterior.draws) == names
    assert set(posterior.summary()["parameters"]) >= names
    for name in names:
        wanted = widening.factors[name] * fit.value_sd(name)
        assert posterior.draws[name].std() == pytest.approx(wanted, rel=0.2)
    points_m = torch.tensor([[0.01, 0.0, 0.0]], dtype=torch.float64)
    low_T, high_T = posterior.field_interval(points_m, {"coil1": CURRENT_A})
    best_T = posterior.field(points_m, {"coil1": CURRENT_A})
    assert bool(((low_T < best_T) & (best_T < high_T)).all())
    assert float((high_T - low_T).max()) < 12.0 * NOISE_T
