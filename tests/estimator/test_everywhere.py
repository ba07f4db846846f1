"""What no laboratory is without is added where the readings tell it from the coils, and only where the rig does not mention it."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.effects.everywhere import tells_constant, with_everywhere
from estimator.model.simulate import simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text
from tests.estimator.conftest import RIG

ROOM, ZERO = Cause("background_field", "room"), Cause("sensor_offset", "hall")
ROOM_IS_KNOWN = RIG + "effects:\n  background_field[room]: {x_T: 0, y_T: 0, z_T: -43.0e-6}\n"


def readings(plan: Plan, *currents_A: float) -> Observations:
    settings = tuple({"coil1": current_A} for current_A in currents_A)
    return simulate(rig_from_text(RIG), replace(plan, currents_A=settings), {}, seed=1).calibration


@pytest.mark.parametrize(
    ("currents_A", "tells"),
    [((3.0,), False), ((3.0, 2.97), False), ((0.0, 3.0), True), ((-3.0, 3.0), True), ((1.5, 3.0), True)],
)
def test_currents_that_change_tell_a_constant_from_the_coils(small_plan, currents_A, tells):
    assert tells_constant(readings(small_plan, *currents_A)) is tells


def test_two_coils_whose_currents_always_have_the_same_sum_tell_no_constant(small_plan):
    made = readings(small_plan, 3.0)
    share = torch.linspace(0.2, 0.8, len(made), dtype=torch.float64)
    both = torch.stack((3.0 * share, 3.0 * (1.0 - share)), dim=1)
    assert not tells_constant(replace(made, current_A=both))
    both[::2] *= 0.5
    assert tells_constant(replace(made, current_A=both))


def test_room_and_zero_are_added_free_at_nothing(small_plan):
    described = with_everywhere(rig_from_text(RIG), readings(small_plan, 0.0, 3.0))
    assert described.added == (ROOM, ZERO)
    assert not described.missing
    assert [p.value for p in described.rig.free[-6:]] == [0.0] * 6


def test_what_the_rig_mentions_is_left_as_it_is(small_plan):
    described = with_everywhere(rig_from_text(ROOM_IS_KNOWN), readings(small_plan, 0.0, 3.0))
    assert described.added == (ZERO,)
    assert described.rig.nominal_values()["background_field[room].z_T"] == -43e-6


def test_with_one_current_nothing_is_added_and_it_is_said(small_plan):
    rig = rig_from_text(RIG)
    described = with_everywhere(rig, readings(small_plan, 3.0))
    assert described.rig is rig
    assert described.missing == (ROOM, ZERO)
