"""Components that are probably outliers are listed where a share of the readings is wrong, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from scipy import stats

from estimator.diagnosis.outlying import outliers_of
from estimator.effects.attach import with_effect
from estimator.rig.parameters import LogNormal
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of

pytestmark = pytest.mark.whole

WRONG = {(3, 0): 4e-4, (11, 2): -2e-4, (20, 1): 1e-4}  # reading and component, and by how much, in T
SHARE, RATIO = 0.02, 30.0


@pytest.fixture(scope="module")
def session(small_session: Session) -> Session:
    field_T = small_session.observations.field_sensor_T.clone()
    field_T[5, 1] = torch.nan  # a component that was not measured
    for (reading, component), error_T in WRONG.items():
        field_T[reading, component] += error_T
    return replace(small_session, observations=small_session.observations.with_field(field_T))


@pytest.fixture(scope="module")
def fit(small_rig: Rig, session: Session):
    rig = with_effect(
        small_rig, Cause("outliers", "hall"), session.observations, {"share": SHARE, "ratio": RATIO}, False
    )
    return fit_of(rig, session.observations.calibration)


def test_the_wrong_components_are_listed_the_farthest_first(fit, session):
    outliers = outliers_of(fit, session.observations, False)
    assert [(o.reading, o.component) for o in outliers] == list(WRONG)
    assert {o.sensor for o in outliers} == {"hall"}
    for outlier, error_T in zip(outliers, WRONG.values(), strict=True):
        sigma_T = float(fit.posterior.sigma_T(fit.vector)[0])
        assert outlier.miss_T == pytest.approx(error_T, abs=5.0 * sigma_T)
        assert outlier.miss_sd == pytest.approx(outlier.miss_T / sigma_T, rel=1e-9)
    assert outliers[0].to_json()["reading"] == 4


def test_a_decimal_point_beside_its_place_is_told_with_the_line_of_the_file(fit, session):
    readings = replace(session.observations, line=torch.arange(len(session.observations)) + 2)
    field_T = readings.field_sensor_T.clone()
    field_T[7, 0] *= 100.0
    field_T[8, 1] *= -1.0
    smallest = int(field_T[12:, 2].abs().argmin()) + 12
    field_T[smallest, 2] += 1e-4  # far off, but of nearly nothing: no factor says so
    written = {(o.reading, o.component): o for o in outliers_of(fit, readings.with_field(field_T), False)}
    assert (written[7, 0].words, written[7, 0].line) == ("is a hundred times too large", 9)
    assert written[8, 1].words == "is reversed"
    assert {written[place].words for place in (*WRONG, (smallest, 2))} == {""}


def test_a_current_of_other_readings_is_told_where_it_would_fit(fit, session):
    """As where the supply was not turned on yet, or already set to the next current."""
    readings = session.observations
    halved = readings.rows(torch.arange(12, len(readings)))
    without = replace(halved, current_A=0.5 * halved.current_A)
    field_T, current_A = readings.field_sensor_T.clone(), readings.current_A.clone()
    field_T[12:], current_A[12:] = fit.model_of(without).predict(fit.values), without.current_A
    row = 12 + int(field_T[12:, 2].abs().argmax())
    current_A[row] = readings.current_A[row]
    outliers = outliers_of(fit, replace(readings, current_A=current_A).with_field(field_T), False)
    (told,) = (o for o in outliers if (o.reading, o.component) == (row, 2))
    full_A = float(readings.current_A[row, 0])
    assert told.words == f"fits {0.5 * full_A:.4g} A where {full_A:.4g} A is written"
    field_T[row, 2] = readings.field_sensor_T[row, 2] + 4.6 * fit.posterior.sigma_T(fit.vector)[0]
    outliers = outliers_of(fit, replace(readings, current_A=current_A).with_field(field_T), False)
    assert {o.words for o in outliers if (o.reading, o.component) == (row, 2)} <= {""}


def test_its_probability_is_that_of_a_mixture_of_two_normals(fit, session):
    for outlier in outliers_of(fit, session.observations, False):
        good = (1.0 - SHARE) * stats.norm.pdf(outlier.miss_sd)
        bad = SHARE * stats.norm.pdf(outlier.miss_sd, scale=RATIO)
        assert outlier.probability == pytest.approx(bad / (good + bad), rel=1e-6)


def test_beside_something_unexplained_only_what_is_far_off_is_listed(fit, session):
    field_T = session.observations.field_sensor_T.clone()
    field_T[9, 2] += 9.0 * fit.posterior.sigma_T(fit.vector)[0]
    readings = session.observations.with_field(field_T)
    alone, beside = (outliers_of(fit, readings, leaves_something) for leaves_something in (False, True))
    assert {(o.reading, o.component) for o in alone} == {*WRONG, (9, 2)}
    assert {(o.reading, o.component) for o in beside} == set(WRONG)


def test_without_that_cause_a_single_component_is_listed_where_nothing_else_is_left(small_rig, small_session):
    readings = small_session.observations
    fit = fit_of(small_rig, readings.calibration)
    sigma_T = float(fit.posterior.sigma_T(fit.vector)[0])
    assert outliers_of(fit, readings, leaves_something=False) == []
    field_T = readings.field_sensor_T.clone()
    field_T[7, 1] += 8.0 * sigma_T
    (outlier,) = outliers_of(fit, readings.with_field(field_T), leaves_something=False)
    assert (outlier.reading, outlier.component) == (7, 1)
    assert outliers_of(fit, readings.with_field(field_T), leaves_something=True) == []


def test_where_a_sensor_scatters_clearly_more_than_expected_only_what_is_far_off_is_listed(
    small_rig, small_session
):
    """Jumps of a winding make noise of 39 uT where 20 are expected; readings that they move are no mistakes."""
    readings = small_session.observations
    stated = small_rig.parameters["hall.noise_T"]
    rig = small_rig.with_parameters([replace(stated, prior=LogNormal(0.4 * stated.value, 1.0))])
    fit = fit_of(rig, readings.calibration)
    field_T = readings.field_sensor_T.clone()
    field_T[7, 1] += 8.0 * float(fit.posterior.sigma_T(fit.vector)[0])
    assert outliers_of(fit, readings.with_field(field_T), leaves_something=False) == []
