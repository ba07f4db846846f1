"""Corrections by steps and by the side that a move left: where they are found, and what they cost in evidence."""

from __future__ import annotations

import re

import pytest
import torch

from estimator.diagnosis.corrections.kinds import CorrectionCandidate, CorrectionKind, kinds_of
from estimator.diagnosis.corrections.steps import Starts, log_choices, steps_of
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import log_mean_exp
from estimator.diagnosis.structure.discrepancy import evidence_by_amplitude
from estimator.diagnosis.structure.families.collection import Family
from estimator.effects.corrections.history import directions
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import corrected, fit_of, with_wrong

pytestmark = pytest.mark.whole

NOISE_T = 5e-6
STEPS, SIDES = Cause("current_steps", "coil1"), Cause("sides_remembered", "arm1")


def hours_of(observations: Observations) -> torch.Tensor:
    return (observations.time_s - observations.time_s.min()) / 3600.0


@pytest.fixture(scope="module")
def opened_h(small_session: Session) -> tuple[float, float]:
    """A contact opens and closes, each time between two readings."""
    times_h = hours_of(small_session.observations).unique()
    return tuple(float(times_h[i - 1 : i + 1].mean()) for i in (len(times_h) // 3, len(times_h) // 2))


@pytest.fixture(scope="module")
def loosened(small_session: Session, opened_h: tuple[float, float]) -> Observations:
    observations = small_session.observations
    hours = hours_of(observations)
    is_open = (hours >= opened_h[0]) & (hours < opened_h[1])
    return observations.with_field((1.0 - 0.2 * is_open[:, None]) * observations.field_sensor_T)


@pytest.fixture(scope="module")
def loosened_fit(small_rig: Rig, loosened: Observations) -> Fit:
    return fit_of(small_rig, loosened.calibration)


def kind_of(fit: Fit, cause: Cause) -> CorrectionKind:
    return next(kind for kind in kinds_of(fit) if kind.cause == cause)


def test_contact_that_opened_and_closed_is_two_steps_at_its_instants(loosened, loosened_fit, opened_h):
    """They are told, to the second; a prediction has none of them."""
    correction = corrected(loosened_fit)
    part = correction.of_session[0]
    assert (part.cause, part.degree) == (STEPS, 2)
    told_s = [float(instant) for instant in re.findall(r"\d+", part.extent)]
    fitted_s = 3600.0 * hours_of(loosened)[~loosened.is_validation]
    for instant_s, found_s in zip([3600.0 * instant_h for instant_h in opened_h], told_s, strict=True):
        between = (fitted_s - found_s).abs() > 0.51  # which rounding decides
        assert bool(((fitted_s >= found_s) == (fitted_s >= instant_s))[between].all())
    assert STEPS not in correction.final.rig.corrections


def test_evidence_of_a_further_step_is_that_of_all_columns_together(loosened_fit):
    columns = CorrectionCandidate.at(kind_of(loosened_fit, STEPS), loosened_fit).columns
    first, second = steps_of(loosened_fit, columns, 2)
    row, evidence = Starts.of(loosened_fit, columns).next_beside([first])
    together = Family.of("", torch.cat((columns[first], columns[row]), dim=1))
    assert row == second
    assert evidence == pytest.approx(
        log_mean_exp(evidence_by_amplitude(loosened_fit, [together])[0]), rel=1e-9
    )


def test_any_of_many_instants_may_be_chance(small_rig: Rig, small_session: Session):
    """Where nothing jumped, the best of all instants has less evidence than none."""
    fit = fit_of(small_rig, small_session.observations.calibration)
    option = CorrectionCandidate.at(kind_of(fit, STEPS), fit).best_option(fit)
    assert option.degree == 1
    assert option.log_bayes_factor < 0.0
    assert log_choices(100, 3) == pytest.approx(torch.tensor(161700.0).log().item())


def test_play_along_a_direction_that_is_no_axis_is_found(small_rig: Rig, small_session: Session):
    unit = directions()[29].tolist()
    given = dict(zip(("unit_x", "unit_y", "unit_z"), unit, strict=True)) | {"reach_m": 0.1}
    given |= {"degree1_x_m": 1e-3, "degree1_z_m": -1e-3, "degree1_rx_m": 2e-3}
    observations = with_wrong(small_rig, small_session.observations, SIDES, given)
    plain = fit_of(small_rig, observations.calibration)
    kind = kind_of(plain, SIDES)
    option = CorrectionCandidate.at(kind, plain).best_option(plain)
    assert option.log_bayes_factor > 20.0
    circumstances = plain.posterior.model.circumstances
    of_truth = kind.effect.factors(circumstances, SIDES.place, [option.start, {**option.start, **given}])
    assert of_truth is not None
    assert bool((of_truth[1].abs() == 1.0).all())
    assert float(of_truth[1].mean().abs()) == 1.0  # both divide the moves alike, whichever is called plus
