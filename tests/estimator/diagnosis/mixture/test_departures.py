"""Departures: what all sensors have in common is one item beside those of single sensors, and is corrected sensor by sensor."""

from __future__ import annotations

import math

import pytest
import torch

from estimator.diagnosis import policy
from estimator.diagnosis.budget import _groups
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.climb import ask
from estimator.diagnosis.mixture.confirmed import answer
from estimator.diagnosis.mixture.correcting import corrected
from estimator.diagnosis.mixture.expansion import Expansion
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.rig.rig import EVERYWHERE, Cause
from estimator.rig_files.read import rig_from_text
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


def test_what_all_sensors_have_in_common_shares_the_prior_of_its_kind_with_single_ones(asked):
    items = [item for item in asked.dictionary.items if item.cause.name == COMMON.name]
    assert {item.cause.place for item in items} == {*SENSORS, EVERYWHERE}
    total = math.fsum(math.exp(item.log_prior) for item in asked.dictionary.items if not item.is_listed)
    common = math.fsum(math.exp(item.log_prior) for item in items if item.cause == COMMON)
    single = math.fsum(math.exp(item.log_prior) for item in items if item.cause != COMMON)
    assert total < policy.DEPARTURE * (1.0 + 1e-9)
    assert 0.0 < common <= single * (1.0 + 1e-9)


def test_it_is_corrected_sensor_by_sensor(asked):
    by_hand = said(asked, {(COMMON,): 100})
    plain = asked.expansion.plain
    correction = corrected(by_hand, plain, plain, Limits())
    assert {part.cause.place for part in correction.parts} == set(SENSORS)
    assert f"sensor_response[{', '.join(SENSORS)}] to degree " in correction.words(lambda cause: cause.label)
    corrections = correction.final.rig.corrections
    assert {cause.place for cause in corrections} == set(SENSORS)
    assert _groups(plain, correction.final) == {COMMON: list(corrections)}  # one share of the error budget


def test_two_sensors_that_respond_oddly_each_in_its_own_way_take_one_slot(asked):
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
