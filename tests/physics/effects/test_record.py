"""Mistakes of the record, worked out by hand: the readings that a person would have written down wrongly."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import (
    DISPLACED,
    POINTS_M,
    RIG,
    assert_same_field,
    predicted_T,
    readings,
    winding,
)

FIELD_T = 2.0 * winding().field_T(POINTS_M)
READINGS = readings(POINTS_M, (2.0, 0.0))
STEPS_M = np.array([[0.01, 0.02, -0.015], [-0.03, 0.015, 0.01], [0.0, -0.02, 0.02]])


def test_swapped_axes_read_the_component_they_name_negative_where_reversed():
    reading_T = predicted_T(
        READINGS, {"axes_swapped[probe]": {"x_reads": -2.0, "y_reads": 1.0, "z_reads": 3.0}}
    )
    expected = np.stack((-FIELD_T[:, 1], FIELD_T[:, 0], FIELD_T[:, 2]), axis=1)
    assert_same_field(reading_T, expected)


def test_what_begins_in_mid_session_spares_the_readings_before():
    time_s = 600.0 * np.arange(len(POINTS_M))
    currents_A = np.column_stack((np.full(len(POINTS_M), 2.0), np.linspace(-1.0, 1.0, len(POINTS_M))))
    is_late = (time_s > 1500.0)[:, None]
    in_time = readings(POINTS_M, currents_A, time_s=time_s)
    given = {"since_h": 1500.0 / 3600.0}
    before_T = in_time_T = predicted_T(in_time)
    exchanged_T = predicted_T(readings(POINTS_M, currents_A[:, ::-1].copy(), time_s=time_s))
    reversed_T = predicted_T(readings(POINTS_M, currents_A * [1.0, -1.0], time_s=time_s))
    swapped_T = in_time_T[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
    for cause, size, after_T in (
        ("axes_swapped_since[probe]", {"x_reads": 2.0, "y_reads": -1.0, "z_reads": 3.0}, swapped_T),
        ("current_sign_since[other]", {"sign": -1.0}, reversed_T),
        ("coils_exchanged_since[coil]", {"later_by": 1.0}, exchanged_T),
    ):
        found_T = predicted_T(in_time, {cause: {**size, **given}})
        assert_same_field(found_T, np.where(is_late, after_T, before_T))


def test_axes_are_looked_for_in_every_order_and_direction_but_the_right_one_and_its_reversal():
    starts = EFFECTS["axes_swapped"].starts(Circumstances(rig_from_text(RIG), READINGS), "probe")
    tried = {tuple(start[f"{axis}_reads"] for axis in "xyz") for start in starts}
    every = {
        tuple(float(s * i) for s, i in zip(signs, order, strict=True))
        for order in permutations((1, 2, 3))
        for signs in product((1, -1), repeat=3)
    }
    assert len(starts) == len(tried) == 46
    assert every - tried == {(1.0, 2.0, 3.0), (-1.0, -2.0, -3.0)}


@pytest.mark.parametrize(
    ("given", "factor"),
    [
        ({"field_factor": 1e3}, 1e3),  # written in mT
        ({"field_factor": 0.1}, 0.1),  # mT written under G
        (
            {"current_factor": 1e3},
            1e-3,
        ),  # the record says 2 where 2 mA flowed: fields are those of a thousandth
    ],
)
def test_unit_error_multiplies_what_is_recorded(given, factor):
    assert_same_field(predicted_T(READINGS, {"unit_error[record]": given}), factor * FIELD_T)


def test_currents_in_another_unit_leave_the_field_of_the_room_as_it_is():
    effects = {"unit_error[record]": {"current_factor": 1e3}, "background_field[room]": {"z_T": 50e-6}}
    assert_same_field(predicted_T(READINGS, effects), 1e-3 * FIELD_T + np.array([0.0, 0.0, 50e-6]))


def displaced_T(steps_m: np.ndarray) -> np.ndarray:
    """The sensor in the world's origin, the coil displaced from 60 mm below it."""
    return 2.0 * winding().field_T(np.array([0.0, 0.0, 0.06]) - steps_m)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_left_handed_record_reverses_one_axis_of_the_displacements(axis):
    sign = np.ones(3)
    sign[axis] = -1.0
    given = {f"{'xyz'[axis]}_sign": -1.0}
    reading_T = predicted_T(
        readings(STEPS_M, (2.0, 0.0), mover="arm"), {"left_handed[arm]": given}, DISPLACED
    )
    assert_same_field(reading_T, displaced_T(sign * STEPS_M))


def test_displacements_in_other_axes_are_turned_into_the_real_ones():
    vector_rad = np.array([0.5, -1.2, 0.8])
    given = dict(zip(("rx_rad", "ry_rad", "rz_rad"), vector_rad, strict=True))
    reading_T = predicted_T(
        readings(STEPS_M, (2.0, 0.0), mover="arm"), {"displacement_frame[arm]": given}, DISPLACED
    )
    assert_same_field(reading_T, displaced_T(Rotation.from_rotvec(vector_rad).apply(STEPS_M)))


def test_displacement_frame_error_undoes_a_base_frame_that_the_rig_file_forgot():
    """A controller that reports in its base's axes, of an arm whose flange stood turned by R: displacements in the flange are R^T t."""
    base_from_flange0 = Rotation.from_rotvec([100.0, -40.0, 20.0], degrees=True)
    turned = base_from_flange0.as_rotvec(degrees=True)
    told = DISPLACED.replace(
        "{motion: displacement}",
        "{motion: displacement, displacement_frame: base, base_from_flange0: "
        f"{{rx_deg: {turned[0]}, ry_deg: {turned[1]}, rz_deg: {turned[2]}}}}}",
    )
    in_base = readings(STEPS_M, (2.0, 0.0), mover="arm")
    undone = dict(zip(("rx_rad", "ry_rad", "rz_rad"), base_from_flange0.inv().as_rotvec(), strict=True))
    reading_T = predicted_T(in_base, {"displacement_frame[arm]": undone}, DISPLACED)
    assert_same_field(reading_T, predicted_T(in_base, None, told), 1e-9)


def test_every_rotation_of_a_cube_is_among_those_that_are_tried():
    circumstances = Circumstances(rig_from_text(DISPLACED), readings(STEPS_M, (2.0, 0.0), mover="arm"))
    starts = EFFECTS["displacement_frame"].starts(circumstances, "arm")
    tried = Rotation.from_rotvec([list(start.values()) for start in starts])
    for quarter in Rotation.create_group("O"):
        if quarter.magnitude() > 1e-9:
            assert (tried.inv() * quarter).magnitude().min() < 1e-6


TWO_PROBES = RIG.replace(
    "probe: {carried_by: mapper, noise_uT: 5}",
    "probe: {carried_by: mapper, noise_uT: 5}\n  fixed: {gain: 1.5, noise_uT: 5, world_from_sensor: {x_mm: 20, y_mm: -30, z_mm: 40, rz_deg: 90}}",
)


def test_exchanged_sensors_stand_at_each_others_places_and_keep_their_gains():
    of_both = readings(POINTS_M, (2.0, 0.0))
    of_both = replace(of_both, sensor=torch.arange(len(POINTS_M)) % 2)
    reading_T = predicted_T(of_both, {"sensors_exchanged[record]": {"first": 1.0, "second": 2.0}}, TWO_PROBES)
    fixed_T = 2.0 * winding().field_T(np.array([[0.02, -0.03, 0.04]]))[0]
    in_fixed_T = np.array([fixed_T[1], -fixed_T[0], fixed_T[2]])  # the frame of a sensor turned by 90 degrees
    is_first = (np.arange(len(POINTS_M)) % 2 == 0)[:, None]
    assert_same_field(reading_T, np.where(is_first, in_fixed_T, 1.5 * FIELD_T))


def test_exchanged_coils_carry_each_others_currents():
    currents_A = np.stack((np.linspace(1.0, 2.0, len(POINTS_M)), np.zeros(len(POINTS_M))), axis=1)
    currents_A[0] = 0.0, 3.0
    recorded, real = readings(POINTS_M, currents_A), readings(POINTS_M, currents_A[:, ::-1])
    reading_T = predicted_T(recorded, {"coils_exchanged[record]": {"first": 1.0, "second": 2.0}})
    assert_same_field(reading_T, predicted_T(real))


@pytest.mark.parametrize(("name", "n"), [("sensors_exchanged", 1), ("coils_exchanged", 1)])
def test_every_pair_is_tried_and_none_where_there_is_one_body(name, n):
    rig = rig_from_text(TWO_PROBES)
    starts = EFFECTS[name].starts(Circumstances(rig, READINGS), "record")
    assert [(start["first"], start["second"]) for start in starts] == [(1.0, 2.0)]
    alone = replace(rig, coils=rig.coils[:n], sensors=rig.sensors[:n])
    assert EFFECTS[name].places(rig) == ("record",)
    assert EFFECTS[name].places(alone) == ()
