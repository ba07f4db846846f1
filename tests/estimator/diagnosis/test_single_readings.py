"""Readings that were recorded otherwise than they were measured are flagged one by one; where the model is wrong, none is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.diagnosis.single_readings import suspects_of
from estimator.readings.flags import Reason
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole


@pytest.fixture
def measured(small_session):
    return small_session.observations


def flagged(rig, readings):
    return suspects_of(fit_of(rig, readings.calibration), readings).flags


def changed(readings, rows, change):
    field_T = readings.field_sensor_T.clone()
    field_T[rows] = change(field_T[rows])
    return readings.with_field(field_T)


MISTAKES = {
    "is reversed": lambda field_T: -field_T,
    "is ten times too small": lambda field_T: 0.1 * field_T,
    "is ten times too large": lambda field_T: 10.0 * field_T,
    "is zero": lambda field_T: 0.0 * field_T,
    "has x and z exchanged": lambda field_T: field_T[:, [2, 1, 0]],
}


@pytest.mark.parametrize("words", list(MISTAKES))
def test_rows_that_a_mistake_explains_are_flagged_with_it(small_rig, measured, words):
    rows = [3, 11, 12, 20]
    (flag,) = flagged(small_rig, changed(measured, rows, MISTAKES[words]))
    assert flag.words.startswith(words)
    assert (flag.reason, flag.component) == (Reason.OTHERWISE, None)
    assert set(flag.readings) <= set(rows)
    is_large = measured.field_sensor_T[rows].abs().amax(1) > 20 * 5e-6
    assert set(flag.readings) >= set(torch.tensor(rows)[is_large].tolist())


def test_one_component_is_told_and_the_others_are_kept(small_rig, measured):
    field_T = measured.field_sensor_T.clone()
    field_T[[4, 8, 9], 2] *= 0.1
    (flag,) = flagged(small_rig, measured.with_field(field_T))
    assert (flag.words, flag.component, flag.readings) == ("is ten times too small", 2, (4, 8, 9))


def test_a_register_that_was_read_too_early_is_told_by_its_digits(small_rig, measured):
    field_T = measured.field_sensor_T.clone()
    field_T[[6, 15], 2] = field_T[[5, 14], 2]
    (flag,) = flagged(small_rig, measured.with_field(field_T))
    assert (flag.reason, flag.component, flag.readings) == (Reason.HELD, 2, (6, 15))


def test_readings_that_repeat_digits_near_what_was_expected_are_told_beside_clear_ones(small_rig, measured):
    rounded = measured.with_field((measured.field_sensor_T / 1e-8).round() * 1e-8)
    clear, near = [5, 12, 18, 24], 2  # 250 µT from the row before, and 13 µT, where noise is 5 µT
    field_T = rounded.field_sensor_T.clone()
    field_T[[*clear, near], 2] = rounded.field_sensor_T[[row - 1 for row in (*clear, near)], 2]
    (flag,) = flagged(small_rig, rounded.with_field(field_T))
    assert flag.words == "repeats the reading before to the last digit"
    assert set(flag.readings) == {*clear, near}


def test_fields_of_a_neighbouring_row_are_told(small_rig, measured):
    field_T = measured.field_sensor_T.clone()
    field_T[10:18] = measured.field_sensor_T[9:17]
    flags = flagged(small_rig, measured.with_field(field_T))
    assert all(flag.words.startswith("holds the field of the reading 1 row before") for flag in flags)
    assert {reading for flag in flags for reading in flag.readings} <= set(range(10, 18))


def test_two_readings_far_apart_that_are_exchanged_are_told_as_a_pair(small_rig, measured):
    field_T = measured.field_sensor_T.clone()
    field_T[[4, 21]] = field_T[[21, 4]]
    (flag,) = flagged(small_rig, measured.with_field(field_T))
    assert (flag.words, flag.readings) == ("is exchanged with another reading", (4, 21))


def with_motion(readings, change):
    """Readings whose recorded pose in some rows is another one."""
    motion = readings.motion["arm1"].clone()
    change(motion)
    return replace(readings, motion={"arm1": motion})


def test_a_pose_that_is_the_one_before_in_each_fifth_row_is_told(small_rig, measured):
    """Each pose was visited once, so no row of the record has the real one."""
    rows = torch.arange(3, len(measured), 5)

    def stale(motion):
        motion[rows] = motion[rows - 1]

    readings = with_motion(measured, stale)
    flags, may_be_causes = suspects_of(fit_of(small_rig, readings.calibration), readings)
    assert not may_be_causes, "so that they are left out before a noise of the sensor explains them"
    told = {reading for flag in flags for reading in flag.readings}
    assert told <= set(rows.tolist())
    assert len(told) > len(rows) / 2
    assert all(
        "has the pose and the currents of the reading before, but another field" in f.words for f in flags
    )


def test_a_pose_that_comes_one_row_late_for_a_while_is_told(small_rig, measured):
    """The current changes from row to row, so no other row has the field that belongs here."""
    size_A = measured.current_A[:, 0] * torch.linspace(0.5, 1.0, len(measured)).to(measured.current_A)
    share = size_A / measured.current_A[:, 0]
    readings = replace(
        measured.with_field(measured.field_sensor_T * share[:, None]), current_A=size_A[:, None]
    )

    def late(motion):
        motion[10:18] = motion[9:17].clone()

    flags = flagged(small_rig, with_motion(readings, late))
    assert any(flag.words.startswith("fits the pose that arm1 has in the reading after") for flag in flags)
    assert {reading for flag in flags for reading in flag.readings} <= set(range(10, 18))


PLACES = {
    "fits arm1_y_m with the other sign": lambda motion: (
        motion * torch.tensor([1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    ),
    "fits a tenth of arm1_z_m": lambda motion: motion * torch.tensor([1.0, 1.0, 10.0, 1.0, 1.0, 1.0]),
    "fits ten times arm1_x_m": lambda motion: motion * torch.tensor([0.1, 1.0, 1.0, 1.0, 1.0, 1.0]),
    "fits arm1_x_m and arm1_z_m exchanged": lambda motion: motion[:, [2, 1, 0, 3, 4, 5]],
}


@pytest.mark.parametrize("words", list(PLACES))
def test_rows_that_were_measured_at_another_place_are_told(small_rig, measured, words):
    motion = measured.motion["arm1"].clone()
    rows = motion[:, :3].all(dim=1).nonzero().flatten()[::3].tolist()  # else the coordinates are alike
    motion[rows] = PLACES[words](motion[rows])
    flags = flagged(small_rig, replace(measured, motion={**measured.motion, "arm1": motion}))
    assert all(words in flag.words for flag in flags)
    assert {reading for flag in flags for reading in flag.readings} <= set(rows)
    assert flags


def test_a_reading_that_no_mistake_explains_is_no_such_reading(small_rig, measured):
    rng = np.random.default_rng(8)
    wild_T = torch.from_numpy(2e-3 * rng.normal(size=(3, 3)))
    assert flagged(small_rig, changed(measured, [3, 11, 20], lambda field_T: field_T + wild_T)) == []


def test_where_the_model_is_wrong_nothing_is_flagged(small_rig, measured):
    wrong = with_wrong(small_rig, measured, Cause("spherical_sum", "coil1"), {"weight": 20.0})
    assert flagged(small_rig, measured) == []
    assert flagged(small_rig, wrong) == []


@pytest.mark.parametrize("rows", [1, -1])
def test_rows_that_are_shifted_to_the_end_may_be_the_cause_of_the_library(small_rig, measured, rows):
    """`rows_shifted_since`, late or early; the first or last row then has the field of no row."""
    field_T = measured.field_sensor_T.clone()
    late, early = measured.field_sensor_T[23:-1], measured.field_sensor_T[[*range(25, 36), 35]]
    field_T[24:] = late if rows == 1 else early
    readings = measured.with_field(field_T)
    suspects = suspects_of(fit_of(small_rig, readings.calibration), readings)
    assert suspects.flags
    assert suspects.may_be_causes


def test_rows_that_are_shifted_for_a_while_are_no_cause_of_the_library(small_rig, measured):
    field_T = measured.field_sensor_T.clone()
    field_T[10:18] = measured.field_sensor_T[9:17]
    readings = measured.with_field(field_T)
    assert not suspects_of(fit_of(small_rig, readings.calibration), readings).may_be_causes
