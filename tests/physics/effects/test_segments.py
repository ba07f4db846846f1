"""What was set up anew in each segment: every part of a session reads as a session of its own would, by the formula of the single cause."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.model.room_field import RoomField
from estimator.readings.observations import Observations
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import (
    POINTS_M,
    RIG,
    assert_same_field,
    effects_text,
    predicted_T,
    readings,
    winding,
)
from tests.physics.effects.test_robot import (
    COIL0,
    COIL0_M,
    DISPLACED,
    STEPS_M,
    TURNS,
    at_poses_T,
    of_displaced_coil_T,
)

OUTSIDE = -1
SEGMENT = np.array([0, 1, 1, OUTSIDE, 0, 1, OUTSIDE])
AT_POSES = readings(POINTS_M, (1.0, 0.0), turn_rad=TURNS.as_rotvec())
SHIFTS_M = np.array(
    [[2e-3, -1e-3, 3e-3], [-1e-3, 0.0, 2e-3], [0.0, 0.0, 0.0]]
)  # of segments 0 and 1, and outside
TURNS_RAD = np.array([[0.02, -0.03, 0.01], [0.0, 0.04, -0.02], [0.0, 0.0, 0.0]])
KEYS = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
ELSEWHERE = {
    f"segment{n}_{key}": value
    for n in (0, 1)
    for key, value in zip(KEYS, (*SHIFTS_M[n], *TURNS_RAD[n]), strict=True)
}


def divided(observations: Observations, segment: np.ndarray) -> Observations:
    return replace(observations, recorded_segment=torch.from_numpy(segment))


def test_zero_is_added_to_the_readings_of_its_segment_and_to_no_other():
    zeros_T = {"segment0_x_T": 3e-5, "segment0_z_T": -1e-5, "segment1_y_T": 2e-5}
    reading_T = predicted_T(divided(AT_POSES, SEGMENT), {"segment_zero[probe]": zeros_T})
    added_T = 1e-5 * np.array([[3.0, 0.0, -1.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.0]])
    assert_same_field(reading_T, at_poses_T(POINTS_M) + added_T[SEGMENT])


def test_gain_multiplies_the_readings_of_its_segment():
    gains = {"segment0_gain": 0.02, "segment1_gain": -0.01}
    reading_T = predicted_T(divided(AT_POSES, SEGMENT), {"segment_gain[probe]": gains})
    assert_same_field(reading_T, np.array([1.02, 0.99, 1.0])[SEGMENT, None] * at_poses_T(POINTS_M))


def test_mover_stands_elsewhere_in_each_segment_and_takes_the_sensor_along():
    reading_T = predicted_T(divided(AT_POSES, SEGMENT), {"segment_misplaced[mapper]": ELSEWHERE})
    turn = Rotation.from_rotvec(TURNS_RAD[SEGMENT])
    assert_same_field(reading_T, at_poses_T(SHIFTS_M[SEGMENT] + turn.apply(POINTS_M), turn * TURNS))


def test_displacements_begin_elsewhere_in_each_segment():
    """A reference configuration that was found again differs by a shift and a turn in the coil's own axes."""
    segment = np.array([0, 1, OUTSIDE])
    reading_T = predicted_T(
        divided(readings(STEPS_M, (1.0, 0.0), mover="arm"), segment),
        {"segment_misplaced[arm]": ELSEWHERE},
        DISPLACED,
    )
    turn = Rotation.from_rotvec(TURNS_RAD[segment])
    moved_m = COIL0_M + COIL0.apply(SHIFTS_M[segment] + turn.apply(STEPS_M))
    assert_same_field(reading_T, of_displaced_coil_T(moved_m, COIL0 * turn))


@pytest.mark.parametrize(
    ("of_segment", "quantities", "single", "same"),
    [
        (
            "segment_zero[probe]",
            {"x_T": 3e-5, "z_T": 1e-5},
            "sensor_offset[probe]",
            {"x_T": 3e-5, "z_T": 1e-5},
        ),
        ("segment_gain[probe]", {"gain": 0.02}, "axis_gain[probe]", dict.fromkeys("xyz", 0.02)),
        (
            "segment_misplaced[mapper]",
            {"y_m": 2e-3, "rx_rad": 0.03},
            "base_misplaced[mapper]",
            {"y_m": 2e-3, "rx_rad": 0.03},
        ),
    ],
)
def test_one_segment_is_the_single_cause(of_segment, quantities, single, same):
    whole = divided(AT_POSES, np.zeros(len(POINTS_M), dtype=np.int64))
    given = {f"segment0_{key}": value for key, value in quantities.items()}
    reading_T = predicted_T(whole, {of_segment: given})
    assert_same_field(reading_T, predicted_T(AT_POSES, {single: same}), 1e-12)
    assert np.abs(reading_T - predicted_T(AT_POSES)).max() > 1e-3 * np.abs(reading_T).max()


def test_segment_is_that_of_the_session_and_not_of_chosen_readings():
    """Without numbers, pauses of the whole session divide it, also where the readings beside a pause are left out."""
    hours = np.array([0.0, 0.001, 0.002, 9.0, 9.001, 9.002, 9.003])
    whole = readings(POINTS_M, (1.0, 0.0), time_s=3600.0 * hours)
    zero = {"segment_zero[probe]": {"segment0_x_T": 3e-5, "segment1_x_T": -2e-5}}
    rows = torch.tensor([5, 0, 1])
    reading_T = predicted_T(whole.rows(rows), zero)
    assert_same_field(reading_T, predicted_T(whole, zero)[rows], 1e-12)
    expected_T = winding().field_T(POINTS_M[rows])
    expected_T[:, 0] += np.array([-2e-5, 3e-5, 3e-5])
    assert_same_field(reading_T, expected_T)


def test_segments_in_which_a_sensor_was_not_read_keep_their_zero():
    two = RIG + "  second: {carried_by: mapper, noise_uT: 5}\n"
    session = replace(
        divided(AT_POSES, np.array([0, 0, 4, 4, 7, 7, 7])), sensor=torch.tensor([0, 1, 1, 0, 1, 1, 1])
    )
    circumstances, effect = Circumstances(rig_from_text(two), session), EFFECTS["segment_zero"]
    assert effect.concerns(circumstances, "probe")
    assert effect.unseen(circumstances, "probe") == {"segment7_x_T", "segment7_y_T", "segment7_z_T"}
    assert not effect.unseen(circumstances, "second")


def test_field_that_is_predicted_lies_in_no_segment():
    points_m = torch.from_numpy(POINTS_M)
    motion = {"arm": torch.tensor([0.02, 0.01, -0.01, 0.0, 0.0, 0.0], dtype=torch.float64)}
    plain = rig_from_text(DISPLACED)
    moved = rig_from_text(DISPLACED + effects_text({"segment_misplaced[arm]": ELSEWHERE}))
    fields_T = []
    for rig in (plain, moved):
        values = {k: torch.tensor(v, dtype=torch.float64) for k, v in rig.nominal_values().items()}
        room = RoomField(rig, values, points_m, motion)
        fields_T.append(room.field_T(values, torch.tensor([1.0, 0.0], dtype=torch.float64)))
    torch.testing.assert_close(fields_T[0], fields_T[1], rtol=1e-12, atol=0.0)
