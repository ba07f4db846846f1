"""Effects of robot and mounts: the reading with the effect is the reading at the pose worked out by hand with SciPy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.physics.effects.laboratory import POINTS_M, RIG, assert_same_field, predicted_T, readings, winding

TURNS = Rotation.random(len(POINTS_M), rng=np.random.default_rng(5))
# The paper's rig: the coil is displaced in the axes of its own mount, the sensor stands still.
DISPLACED = (
    RIG.replace("{mapper: {motion: pose}}", "{arm: {motion: displacement}}")
    .replace(
        "  coil: {radius_mm: 40",
        "  coil: {carried_by: arm, world_from_coil0: {x_mm: 3, z_mm: -60, rx_deg: 10, ry_deg: 5}, radius_mm: 40",
    )
    .replace("carried_by: mapper, noise", "world_from_sensor: {rx_deg: 25, rz_deg: 40}, noise")
)
COIL0_M, COIL0 = np.array([0.003, 0.0, -0.06]), Rotation.from_rotvec([10.0, 5.0, 0.0], degrees=True)
SENSOR = Rotation.from_rotvec([25.0, 0.0, 40.0], degrees=True)
STEPS_M = np.array([[0.0, 0.0, 0.0], [0.02, 0.01, -0.01], [-0.03, 0.015, 0.01]])


def at_poses_T(points_m: np.ndarray, turn: Rotation = TURNS) -> np.ndarray:
    """What the carried sensor reads of one ampere in the coil, at real poses."""
    return turn.inv().apply(winding().field_T(points_m))


def of_displaced_coil_T(
    positions_m: np.ndarray, turns: Rotation, sensor_m: np.ndarray | None = None
) -> np.ndarray:
    """What the standing sensor reads of one ampere in a coil at poses in the world."""
    sensor_m = np.zeros((len(positions_m), 3)) if sensor_m is None else sensor_m
    in_coil_m = turns.inv().apply(sensor_m - positions_m)
    return SENSOR.inv().apply(turns.apply(winding().field_T(in_coil_m)))


def test_displaced_coil_without_effects_stands_where_its_own_axes_take_it():
    reading_T = predicted_T(readings(STEPS_M, (1.0, 0.0), mover="arm"), None, DISPLACED)
    assert_same_field(reading_T, of_displaced_coil_T(COIL0_M + COIL0.apply(STEPS_M), COIL0))


# Two readings at the first position, a move along x and y, one along y back and z, a rest, one along x back.
PATH_M = 1e-3 * np.array([[0, 0, 40], [0, 0, 40], [3, 4, 40], [3, 1, 44], [3, 1, 44], [-2, 1, 44]])


def test_backlash_keeps_each_axis_half_its_play_short_on_the_side_it_came_from():
    """An axis that rests keeps the side of its last move, whatever the others do."""
    play_m = np.array([2e-4, 3e-4, -1e-4])
    side = np.array([[0, 0, 0], [0, 0, 0], [1, 1, 0], [1, -1, 1], [1, -1, 1], [-1, -1, 1]])
    given = dict(zip(("x_m", "y_m", "z_m"), play_m, strict=True))
    reading_T = predicted_T(readings(PATH_M, (1.0, 0.0)), {"backlash[mapper]": given})
    assert_same_field(reading_T, winding().field_T(PATH_M - 0.5 * play_m * side))


@pytest.mark.parametrize(
    ("effect", "given"), [("position_lag", {"lag_m": 2e-4}), ("backlash", {"x_m": 2e-4, "z_m": 3e-4})]
)
def test_what_went_before_is_the_sessions_and_not_that_of_chosen_readings(effect, given):
    whole = readings(PATH_M, (1.0, 0.0))
    rows = np.array([5, 2, 4])
    reading_T = predicted_T(whole.rows(whole.row[rows]), {f"{effect}[mapper]": given})
    assert_same_field(reading_T, predicted_T(whole, {f"{effect}[mapper]": given})[rows], 1e-12)


def test_tilted_mount_turns_rotations_of_the_arm_about_other_axes():
    """Of an arm that turns by D, a coil on a mount turned by R turns by R^T D R."""
    tilt = Rotation.from_rotvec([0.02, -0.03, 0.0])
    arm = Rotation.from_rotvec([[0.1, 0.2, -0.1], [0.3, 0.0, 0.0], [0.0, 0.0, 0.5]])
    reading_T = predicted_T(
        readings(STEPS_M, (1.0, 0.0), turn_rad=arm.as_rotvec(), mover="arm"),
        {"mount_tilt[coil]": {"x_rad": 0.02, "y_rad": -0.03}},
        DISPLACED,
    )
    turns = COIL0 * tilt.inv() * arm * tilt
    assert_same_field(reading_T, of_displaced_coil_T(COIL0_M + COIL0.apply(tilt.inv().apply(STEPS_M)), turns))


def test_bumped_sensor_sits_elsewhere_in_its_own_axes_from_the_instant_on():
    bump_m = np.array([4e-4, -3e-4, 8e-4])
    reading_T = predicted_T(
        readings(STEPS_M, (1.0, 0.0), mover="arm", time_s=np.array([0.0, 360.0, 720.0])),
        {"sensor_bumped[probe]": dict(zip(("x_m", "y_m", "z_m"), bump_m, strict=True)) | {"since_h": 0.15}},
        DISPLACED,
    )
    sensor_m = np.array([0.0, 0.0, 1.0])[:, None] * SENSOR.apply(bump_m)
    assert_same_field(reading_T, of_displaced_coil_T(COIL0_M + COIL0.apply(STEPS_M), COIL0, sensor_m))


def test_slipped_mover_stands_elsewhere_in_its_own_axes_from_the_instant_on():
    slip_m = np.array([4e-4, -3e-4, 8e-4])
    given = dict(zip(("x_m", "y_m", "z_m"), slip_m, strict=True)) | {"since_h": 0.15}
    session = readings(STEPS_M, (1.0, 0.0), mover="arm", time_s=np.array([0.0, 360.0, 720.0]))
    reading_T = predicted_T(session, {"mover_slipped[arm]": given}, DISPLACED)
    real_m = STEPS_M + np.array([0.0, 0.0, 1.0])[:, None] * slip_m
    assert_same_field(reading_T, of_displaced_coil_T(COIL0_M + COIL0.apply(real_m), COIL0))


def test_bumped_sensor_on_a_robot_takes_its_shift_along():
    bump_m = np.array([4e-4, -3e-4, 8e-4])
    reading_T = predicted_T(
        readings(POINTS_M, (1.0, 0.0), turn_rad=TURNS.as_rotvec()),
        {"sensor_bumped[probe]": dict(zip(("x_m", "y_m", "z_m"), bump_m, strict=True)) | {"since_h": 0.0}},
    )
    assert_same_field(reading_T, at_poses_T(POINTS_M + TURNS.apply(bump_m)))
