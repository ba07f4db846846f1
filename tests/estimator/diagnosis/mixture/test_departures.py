"""Departures: what all sensors have in common is one item beside those of single sensors, and is corrected sensor by sensor."""

from __future__ import annotations

import math

import pytest
import torch

from estimator.diagnosis import policy
from estimator.diagnosis.budget import _groups
from estimator.diagnosis.hypotheses.candidates import causes_of
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.climb import Asked, ask
from estimator.diagnosis.mixture.confirmed import answer
from estimator.diagnosis.mixture.correcting import corrected
from estimator.diagnosis.mixture.departures import Changes
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.rig.rig import EVERYWHERE, Cause, Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from tests.estimator.diagnosis.mixture.hand_made import said
from tests.estimator.diagnosis.small_fits import fit_of

pytestmark = pytest.mark.whole

SENSORS = ("hall", "other")
COMMON = Cause("sensor_response", EVERYWHERE)


@pytest.fixture(scope="module")
def asked(rig_text: str, small_plan: Plan, small_truth: dict[str, float]) -> Asked:
    """Two sensors side by side, with nothing wrong."""
    rig = rig_from_text(f"{rig_text}  other: {{noise_uT: 5, world_from_sensor: {{x_mm: 15}}}}\n")
    plain = fit_of(rig, simulate(rig, small_plan, small_truth, seed=3))
    return ask(Expansion.of(plain), Limits(), 1, {})


def test_what_all_sensors_have_in_common_shares_the_prior_of_its_kind_with_single_ones(asked: Asked):
    items = [item for item in asked.dictionary.items if item.cause.name == COMMON.name]
    assert {item.cause.place for item in items} == {*SENSORS, EVERYWHERE}
    total = math.fsum(math.exp(item.log_prior) for item in asked.dictionary.items if not item.is_listed)
    common = math.fsum(math.exp(item.log_prior) for item in items if item.cause == COMMON)
    single = math.fsum(math.exp(item.log_prior) for item in items if item.cause != COMMON)
    assert total < policy.DEPARTURE * (1.0 + 1e-9)
    assert 0.0 < common <= single * (1.0 + 1e-9)


def test_its_columns_are_those_of_the_single_sensors(asked: Asked):
    items, columns = asked.dictionary.items, asked.dictionary.columns
    common = next(item for item in items if item.cause == COMMON)
    n = len(common.keys) // len(SENSORS)
    for place, own in zip(SENSORS, (common.columns[:n], common.columns[n:]), strict=True):
        single = next(i for i in items if i.cause == Cause(COMMON.name, place) and len(i.keys) == n)
        assert single.columns == own
        assert [f"{place}.{key}" for key in single.keys] == list(common.keys)[:n] or place != SENSORS[0]
    assert torch.linalg.matrix_rank(columns[:, list(common.columns)]) > n


def test_it_is_corrected_sensor_by_sensor(asked: Asked):
    by_hand = said(asked, {(COMMON,): 100})
    plain = asked.expansion.plain
    correction = corrected(by_hand, plain, plain, Limits())
    assert {part.cause.place for part in correction.parts} == set(SENSORS)
    assert f"sensor_response[{', '.join(SENSORS)}] to degree " in correction.words(lambda cause: cause.label)
    corrections = correction.final.rig.corrections
    assert {cause.place for cause in corrections} == set(SENSORS)
    assert _groups(plain, correction.final) == {COMMON: list(corrections)}  # one share of the error budget


def test_columns_of_a_fit_nearby_are_reused_and_those_of_a_far_one_made_anew(asked: Asked):
    fit = asked.expansion.fit
    causes = causes_of(fit.rig, fit, Limits())
    changes = asked.changes
    assert changes.is_near(fit)
    fresh = Changes.about(asked.expansion, causes).pool
    assert [candidate.cause for candidate in changes.pool] == [candidate.cause for candidate in fresh]
    for first, second in zip(changes.pool, fresh, strict=True):
        torch.testing.assert_close(first.columns, second.columns)
    readings = fit.observations.with_field(1.1 * fit.observations.field_sensor_T)
    assert not changes.is_near(fit_of(fit.rig, readings))


def test_what_a_rig_follows_of_a_column_moves_with_the_rig(small_rig: Rig, small_session: Session):
    """Of turns that are wound otherwise it follows nearly all: the rest is small beside what a fit nearby changes of it."""
    readings = small_session.observations.calibration
    first = Expansion.of(fit_of(small_rig, readings))
    second = Expansion.of(fit_of(small_rig, readings.with_field(1.01 * readings.field_sensor_T)))
    causes = [Cause("winding_misstated", "coil1")]
    about = Changes.about(first, causes)
    assert about.is_near(second.fit)
    (old,), (moved,) = about.pool, about.moved(second, causes).pool
    (fresh,) = Changes.about(second, causes).pool
    right = second.always.rest(fresh.columns).norm()
    error = second.always.rest(moved.columns - fresh.columns).norm() / right
    error_at_rest = second.always.rest(old.columns - fresh.columns).norm() / right
    assert float(error) < 0.1
    assert float(error) < 0.6 * float(error_at_rest)


def test_two_sensors_that_respond_oddly_each_in_its_own_way_take_one_slot(asked: Asked):
    plain = asked.expansion.plain
    readings, random = plain.observations, torch.Generator().manual_seed(5)
    field_T = readings.field_sensor_T
    curve = field_T.norm(dim=-1, keepdim=True) / field_T.norm(dim=-1).max()
    mixing = 0.05 * torch.randn(2, len(SENSORS), 3, 3, generator=random, dtype=field_T.dtype)
    straight, bent = (torch.einsum("rij,rj->ri", by_sensor[readings.sensor], field_T) for by_sensor in mixing)
    odd = readings.with_field(field_T + straight + curve * bent)
    said_of = answer(fit_of(plain.rig, odd), Limits(), 1, n_pairs=1)
    leading = [said_of.asked.dictionary.items[i] for i in said_of.asked.leading]
    assert COMMON in {item.cause for item in leading}
    assert {item.cause.place for item in leading if not item.is_listed} == {EVERYWHERE}
