"""Corrections: the closed form of their posterior, a field of unknown sources that they follow, and when they are refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.corrections.choice import best_corrected
from estimator.diagnosis.corrections.kinds import CorrectionCandidate, kinds_of
from estimator.diagnosis.corrections.linear_fit import density_in_full
from estimator.diagnosis.extension import extended_rig
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.posterior import extended_posterior
from estimator.diagnosis.structure.cross_validation import log_predictive
from estimator.diagnosis.structure.discrepancy import discrepancy
from estimator.diagnosis.structure.families import families
from estimator.diagnosis.validation import improvement_of, validation_scores
from estimator.diagnosis.widening import Widening
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.corrections.correction import Correction, Limit, limit_of_places
from estimator.effects.use import is_in_field
from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.model.room_field import RoomField
from estimator.readings.observations import Observations
from estimator.readings.split import pose_blocks
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import corrected, fit_of, predicted_T, unheard, with_wrong

pytestmark = pytest.mark.whole

HARMONICS, GAIN = Cause("coil_harmonics", "coil1"), Cause("axis_gain", "hall")
N_TERMS = {1: 3, 2: 8, 3: 15, 4: 24, 5: 35}
CURRENT_A = 3.0
NOISE_T = 5e-6


def with_dipole(observations: Observations, coil_z_m: float) -> Observations:
    """Readings with a dipole in them that hangs beside the coil and is driven by its current: the room's and the coil's axes are parallel."""
    at_m = -(observations.motion["arm1"][:, :3] + torch.tensor([0.0, 0.0, coil_z_m], dtype=torch.float64))
    arm_m = at_m - torch.tensor([0.11, 0.05, 0.06], dtype=torch.float64)
    moment = observations.current_A[:, :1] / CURRENT_A * torch.tensor([0.15, 0.25, -0.3], dtype=torch.float64)
    r2 = arm_m.square().sum(-1, keepdim=True)
    field_T = 1e-7 * (3.0 * arm_m * (arm_m * moment).sum(-1, keepdim=True) - r2 * moment) * r2**-2.5
    return observations.with_field(observations.field_sensor_T + field_T)


@pytest.fixture(scope="module")
def flawed(small_session: Session) -> Observations:
    return with_dipole(small_session.observations, small_session.truth["coil1.world_from_coil0.z_m"])


@pytest.fixture(scope="module")
def plain(small_rig: Rig, flawed: Observations) -> Fit:
    return fit_of(small_rig, flawed.calibration)


@pytest.fixture(scope="module")
def corrected_fit(plain: Fit) -> Fit:
    correction = corrected(plain)
    assert correction.parts[0].cause.name in ("coil_harmonics", "coil_multipoles")
    return correction.fit


def test_unknown_source_beside_the_coil_is_corrected_where_nothing_was_read(plain, corrected_fit, flawed):
    before, after = (validation_scores(fit, flawed.validation) for fit in (plain, corrected_fit))
    assert before.errors.vector_T > 3.0 * NOISE_T * 3**0.5
    assert after.errors.vector_T < 1.3 * NOISE_T * 3**0.5
    assert after.coverage90 > 0.8
    assert corrected_fit.rig.effects == ()
    assert corrected_fit.rig.corrections


def test_linear_model_says_what_a_full_fit_says(plain: Fit):
    """Evidence, predictions, and those of blocks held out, of a correction many times the noise."""
    kind = next(kind for kind in kinds_of(plain) if kind.cause == HARMONICS)
    linear = CorrectionCandidate.at(kind, plain).best_option(plain).fitted(plain)
    full = fit_rig(linear.rig, plain.observations, linear.values, plain.posterior.model.rules)
    gain = full.log_evidence - plain.log_evidence
    assert gain > 50.0
    assert linear.log_evidence - plain.log_evidence == pytest.approx(gain, rel=0.02)
    block = pose_blocks(plain.observations, np.random.default_rng(0))
    before, *after = (float(log_predictive(fit, block).sum()) for fit in (plain, linear, full))
    assert after[0] - before == pytest.approx(after[1] - before, rel=0.02)
    difference = (linear.predicted_T - full.predicted_T) * full.whitening_per_T
    assert float(difference.square().mean().sqrt()) < 0.1


def test_where_the_linear_model_does_not_hold_a_trial_is_fitted_in_full(plain: Fit):
    """Columns that are wrong by a factor of a hundred, as of another fit, ask for a hundred times the amplitudes."""
    kind = next(kind for kind in kinds_of(plain) if kind.cause == HARMONICS)
    option = CorrectionCandidate.at(kind, plain).best_option(plain)
    widths = {key: 100.0 * width for key, width in option.widths.items()}
    wrong = replace(option, widths=widths, columns_T=0.01 * option.columns_T)
    assert density_in_full(wrong.fitted(plain)) > density_in_full(plain) + 50.0


def test_corrected_rig_survives_its_file_and_predicts_the_same(small_rig, plain, corrected_fit):
    rig = extended_rig(small_rig, corrected_fit)
    again = rig_from_text(rig_text(rig))
    assert again == rig
    assert again.hash == rig.hash
    assert "corrections:" in rig_text(rig)
    points_m = torch.tensor([[0.0, 0.0, 0.01], [0.01, -0.01, 0.0]], dtype=torch.float64)
    current_A = torch.tensor([CURRENT_A], dtype=torch.float64)
    fields_T = [
        RoomField(f.rig, f.values, points_m).field_T(f.values, current_A) for f in (plain, corrected_fit)
    ]
    values = corrected_fit.values
    torch.testing.assert_close(RoomField(again, values, points_m).field_T(values, current_A), fields_T[1])
    assert float((fields_T[1] - fields_T[0]).norm(dim=-1).min()) > NOISE_T


def test_posterior_of_the_amplitudes_is_that_of_linear_least_squares(small_rig: Rig, flawed: Observations):
    """With all else fixed: precision X^T X / sigma^2 + 1 / w^2, with columns by differences of predictions."""
    width = 2e-6
    rig = small_rig.with_fixed(p.name for p in small_rig.free)
    rig = with_effect(rig, HARMONICS, flawed, {"degree2_cos0_T_per_A": 0.0, "reach_m": 0.06})
    amplitudes = [p for p in rig.free if p.name.startswith(HARMONICS.label)]
    assert len(amplitudes) == N_TERMS[2]
    rig = rig.with_parameters(replace(p, prior=Normal(0.0, width)) for p in amplitudes)
    fit = fit_rig(rig, flawed, {}, MeasurementModel.build(rig, flawed).rules)
    zero_T = predicted_T(rig, flawed)
    columns = [(predicted_T(rig.with_values({p.name: 1.0}), flawed) - zero_T).flatten() for p in amplitudes]
    design = torch.stack(columns, dim=1)
    precision = design.T @ design / NOISE_T**2 + torch.eye(len(amplitudes)).double() / width**2
    mean = torch.linalg.solve(precision, design.T @ (flawed.field_sensor_T - zero_T).flatten() / NOISE_T**2)
    fitted = torch.stack([fit.values[p.name] for p in amplitudes])
    torch.testing.assert_close(fitted, mean, rtol=0.0, atol=1e-4 * width)
    torch.testing.assert_close(fit.covariance, torch.linalg.inv(precision), rtol=1e-6, atol=1e-12 * width**2)


def test_nothing_is_corrected_where_a_cause_explains_all(small_rig: Rig, small_session: Session):
    observations = with_wrong(small_rig, small_session.observations, GAIN, {"x": 0.05})
    correction = corrected(fit_of(small_rig, observations.calibration, GAIN))
    assert correction.parts == ()
    assert not correction.is_taken
    assert correction.words(str) == f"Nothing is corrected: {correction.refusal}."


def test_a_kind_is_cut_to_a_number_of_amplitudes(plain: Fit):
    kind = next(kind for kind in kinds_of(plain) if kind.cause == HARMONICS)
    assert kind.limit.degree == 4
    assert [kind.with_at_most(n).limit.degree for n in (24, 23, 8, 2)] == [4, 3, 2, 1]


def test_a_pile_that_leaves_nothing_corrects_by_itself(
    small_rig: Rig, small_session: Session, monkeypatch: pytest.MonkeyPatch
):
    """Its causes have no name, but predictions with them are right where those of the bare rig are not."""
    monkeypatch.setattr(policy, "MOST_KINDS", 1)
    observations, offset = small_session.observations, Cause("sensor_offset", "hall")
    observations = with_wrong(small_rig, observations, GAIN, {"x": 0.05})
    observations = with_wrong(small_rig, observations, offset, {"z_T": 100e-6})
    bare, pile = (fit_of(small_rig, observations.calibration, *causes) for causes in ((), (GAIN, offset)))
    correction = best_corrected(bare, pile, bare, unheard, Limits())
    assert correction.is_taken
    assert correction.parts == ()
    assert correction.fit is pile
    assert "by the causes that stand in;" in correction.words(str)
    gain = improvement_of(bare, correction.final, observations.validation)
    assert correction.judged_by(gain).is_taken
    assert gain.after.errors.vector_T < 0.5 * gain.before.errors.vector_T
    alone = best_corrected(pile, pile, pile, unheard, Limits())
    assert not alone.is_taken  # nothing beyond what is named already


def test_few_causes_that_stand_in_correct_where_they_do_better_than_what_corrects_the_bare_rig(
    small_rig: Rig, small_session: Session
):
    """Nothing is left beside them, while the bare rig asks for corrections that make up for less."""
    observations, offset = small_session.observations, Cause("sensor_offset", "hall")
    observations = with_wrong(small_rig, observations, GAIN, {"x": 0.05})
    observations = with_wrong(small_rig, observations, offset, {"z_T": 100e-6})
    bare, few = (fit_of(small_rig, observations.calibration, *causes) for causes in ((), (GAIN, offset)))
    assert corrected(bare).parts
    correction = best_corrected(bare, few, bare, unheard, Limits())
    assert correction.is_taken
    assert correction.parts == ()
    assert correction.fit is few


def test_a_current_that_swings_is_told_with_its_period_and_handed_out_to_no_prediction(
    small_rig: Rig, small_session: Session
):
    """A fit moves the period from the grid. Beside it the coil would have another strength than a prediction has."""
    observations = small_session.observations
    hours = (observations.time_s - observations.time_s.min()) / 3600.0
    frequency_per_h = 4.3 / float(hours.max())  # between two of the grid
    swing = 1.0 + 0.05 * torch.sin(2.0 * torch.pi * frequency_per_h * hours)[:, None]
    plain = fit_of(small_rig, observations.with_field(swing * observations.field_sensor_T).calibration)
    correction = corrected(plain)
    (part, *_) = correction.of_session
    assert part.cause == Cause("current_swings", "coil1")
    told = re.fullmatch(r"with a period of ([\d.]+) s", part.extent)
    assert told is not None
    assert float(told[1]) == pytest.approx(3600.0 / frequency_per_h, rel=0.02)
    assert f"looks like current_swings[coil1] {part.extent}" in correction.words(lambda cause: cause.label)
    assert "current_swings" not in {cause.name for cause in correction.final.rig.corrections}
    assert all(is_in_field(small_rig, part.cause) for part in correction.parts)


def test_only_what_predictions_have_is_handed_out(plain: Fit):
    """Of a current that depends on what was before, its sign; nothing of time, of a sensor, or of where a probe was carried."""
    kinds = {kind.cause.name: kind for kind in kinds_of(plain)}
    handed_out = {name for name, kind in kinds.items() if kind.as_predicted(plain.rig) is not None}
    assert handed_out >= {"coil_harmonics", "guide_errors", "guide_swings"}
    assert handed_out <= {
        *("coil_harmonics", "coil_multipoles", "coil_bore", "room_harmonics", "room_bore", "room_answers"),
        *("guide_errors", "guide_swings", "current_remembered"),
    }
    assert handed_out < set(kinds)
    held = plain.rig
    carried = replace(held, sensors=tuple(replace(sensor, carried_by="arm1") for sensor in held.sensors))
    assert not is_in_field(carried, Cause("guide_errors", "arm1"))
    varied = replace(kinds["current_steps"], effect=EFFECTS["current_remembered"], limit=Limit(4))
    assert varied.as_predicted(plain.rig).limit.degree == 1


def test_no_correction_is_asked_when_the_time_is_over(plain: Fit):
    over = best_corrected(plain, plain, plain, unheard, Limits(minutes=0.0))
    assert not over.is_taken
    assert over.is_cut_short
    assert over.final is plain
    assert over.words(str) == "Nothing is corrected: its time of 0 min was over."
    assert not corrected(plain).is_cut_short


def test_correction_that_predicts_unseen_readings_worse_is_dropped(plain: Fit, flawed: Observations):
    """Unseen readings of a session without the dipole refute it; they are the ones that count."""
    clean = with_dipole(flawed.validation, -0.0425)
    opposite = flawed.validation.with_field(2.0 * flawed.validation.field_sensor_T - clean.field_sensor_T)
    taken = corrected(plain)
    assert taken.judged_by(improvement_of(plain, taken.final, flawed.validation)).is_taken
    dropped = taken.judged_by(improvement_of(plain, taken.final, opposite))
    assert not dropped.is_taken
    assert "unseen" in dropped.refusal
    assert dropped.gain is not None


def test_coil_keeps_the_interval_that_what_was_left_gave_it_and_the_field_stays_sure(plain, corrected_fit):
    left = discrepancy(plain, families(plain))
    before = Widening.of(plain, plain, left)
    after = before.carried_to(corrected_fit)
    names = corrected_fit.posterior.coordinates.names
    for i, name in enumerate(plain.posterior.coordinates.names):
        assert after.covariance[names.index(name), names.index(name)] > 0.999 * before.covariance[i, i]
        assert before.factors[name] > 1.5
    jacobian = corrected_fit.jacobian
    field_sd = [
        ((jacobian @ c) * jacobian).sum(-1).sqrt().median()
        for c in (corrected_fit.covariance, after.covariance)
    ]
    assert field_sd[1] < 1.5 * field_sd[0]


def test_ties_of_numbers_in_a_fit_that_corrections_have_moved_do_not_open_the_field(plain, corrected_fit):
    """What the earlier fit tied together, so that the field stayed sure, would leave it open in the later one."""
    names = corrected_fit.posterior.coordinates.names
    own = plain.posterior.coordinates.names
    rows = [names.index(name) for name in own]
    sd = corrected_fit.covariance[rows][:, rows].diagonal().sqrt()
    sign = torch.tensor([(-1.0) ** i for i in range(len(own))], dtype=torch.float64)
    tied = sign * sign[:, None] + 1e-6 * torch.eye(len(own), dtype=torch.float64)  # all numbers as one
    wide = 900.0 * sd * sd[:, None] * tied
    after = Widening(plain, wide).carried_to(corrected_fit).covariance
    assert (after[rows][:, rows].diagonal() > 0.999 * wide.diagonal()).all()
    jacobian = corrected_fit.jacobian
    before_sd, after_sd = (
        ((jacobian @ c) * jacobian).sum(-1).sqrt() for c in (corrected_fit.covariance, after)
    )
    assert (after_sd < 30.0 * before_sd).all()


def test_posterior_of_a_corrected_rig_is_drawn_without_sampling_its_amplitudes(
    small_rig, small_session, flawed, small_settings
):
    """The draws are as wide as the widening wants them, and the field is as sure as the readings."""
    count = "coil1.axial_loops"
    known = small_rig.with_values({count: small_session.truth[count]}).with_fixed([count])
    searched = fit_of(known, flawed.calibration)
    fit = corrected(searched).fit
    widening = Widening.of(searched, searched, discrepancy(searched, families(searched))).carried_to(fit)
    rig = extended_rig(known, fit)
    session = Session(known, flawed, "simulated")
    posterior = extended_posterior(session, rig, widening, seed=1, settings=small_settings)
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
    assert float((high_T - low_T).max()) < 6.0 * NOISE_T


@pytest.mark.parametrize(
    ("places_m", "degree", "words"),
    [
        (torch.rand(200, 3, generator=torch.Generator().manual_seed(1)), 5, ""),
        (
            torch.rand(20, 3, generator=torch.Generator().manual_seed(1)),
            3,
            "20 places; measure at 24 or more",
        ),
        (torch.rand(2, 3).repeat(50, 1), 0, "one line"),
        (torch.rand(3, 3, generator=torch.Generator().manual_seed(1)), 1, "measure at 8"),
        (torch.rand(1, 3).expand(50, 3), 0, "move the sensor"),
        (torch.rand(90, 1) * torch.ones(3), 0, "measure beside it"),
        (
            torch.rand(90, 3, generator=torch.Generator().manual_seed(1)) * torch.tensor([1.0, 1.0, 0.0]),
            2,
            "off it",
        ),
    ],
)
def test_places_limit_the_degree(places_m: Tensor, degree: int, words: str):
    limit = limit_of_places(places_m.double(), N_TERMS)
    assert limit.degree == degree
    assert words in limit.words


def test_field_of_the_room_is_refused_at_one_current_beside_a_coil_that_stands_still(small_session):
    effect = EFFECTS["room_harmonics"]
    assert isinstance(effect, Correction)
    observations = small_session.observations
    text = (
        rig_text(small_session.rig)
        .replace("    carried_by: arm1\n", "")
        .replace("world_from_coil0", "world_from_coil")
    )
    text = text.replace("hall: {", "hall: {carried_by: arm1, ")
    rig = rig_from_text(text)
    assert "measure without current" in effect.limit(Circumstances(rig, observations), "room").words
    off = replace(
        observations, current_A=observations.current_A * (torch.arange(len(observations)) % 2)[:, None]
    )
    assert effect.limit(Circumstances(rig, off), "room").degree > 0
    with pytest.raises(InvalidInput, match="must stand under corrections"):
        rig_from_text(rig_text(rig) + "effects:\n  zero_wanders[hall]: {duration_h: 1}\n")
