"""Corrections that are no fields: what they do to a reading, worked out by hand with numpy from the readings without them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.effects.attach import with_effect
from estimator.effects.corrections.guides import directions
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text

RIG = """
schema_version: 1
name: displaced coil
movers: {arm: {motion: displacement}}
coils:
  coil: {carried_by: arm, radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 6, radial_loops: 4, world_from_coil0: {x_mm: 3, z_mm: -60}}
sensors:
  hall: {noise_uT: 5, world_from_sensor: {rx_deg: 25, rz_deg: 40}}
"""
N, DURATION_H = 14, 0.5
RNG = np.random.default_rng(11)
POSITIONS_M = RNG.uniform(-0.03, 0.03, (N, 3))
HOURS = np.concatenate(([0.0], np.sort(RNG.uniform(0.0, DURATION_H, N - 2)), [DURATION_H]))
CURRENT_A = RNG.choice([-2.0, 1.0, 3.0], N)
RECORDED_T = RNG.uniform(-1e-3, 1e-3, (N, 3))
SENSOR = Rotation.from_matrix(Rotation.from_rotvec([25.0, 0.0, 40.0], degrees=True).as_matrix())


def predicted_T(
    correction: tuple[Cause, Mapping[str, float]] | None = None,
    shift_m: np.ndarray | None = None,
    turn_rad: np.ndarray | None = None,
) -> np.ndarray:
    """Readings with a correction, or at other displacements."""
    motion = np.zeros((N, 6))
    motion[:, :3] = POSITIONS_M + (0.0 if shift_m is None else shift_m)
    motion[:, 3:] = 0.0 if turn_rad is None else turn_rad
    observations = Observations.of(
        torch.from_numpy(CURRENT_A)[:, None],
        {"arm": torch.from_numpy(motion)},
        torch.from_numpy(RECORDED_T),
        time_s=torch.from_numpy(3600.0 * HOURS),
    )
    rig = rig_from_text(RIG)
    if correction is not None:
        rig = with_effect(rig, correction[0], observations, correction[1], is_free=False)
    values = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
    with torch.no_grad():
        return MeasurementModel.build(rig, observations).predict(values).expand(N, 3).numpy()


PLAIN_T = predicted_T()
MOVES_M = np.diff(POSITIONS_M, axis=0, prepend=POSITIONS_M[:1])
UNIT = np.eye(3)
Formula = Callable[[], np.ndarray]


def cosines(way: np.ndarray, degree: int) -> np.ndarray:
    return np.cos(np.pi * degree * way)


def from_instant(instant_h: float) -> np.ndarray:
    return (instant_h <= HOURS)[:, None]


def side_left(unit: np.ndarray) -> np.ndarray:
    """Sign of the last move along a direction, plus before the first."""
    sides, side = [], 1.0
    for move_m in MOVES_M:
        along_m = sum(m * u for m, u in zip(move_m, unit, strict=True))
        if abs(along_m) > 1e-9:
            side = 1.0 if along_m > 0.0 else -1.0
        sides.append(side)
    return np.array(sides)[:, None]


def before(values: np.ndarray, by: int) -> np.ndarray:
    """What stood so many readings before; the first where there were none."""
    return np.stack([values[max(i - by, 0)] for i in range(len(values))])


def largest_turned_A() -> np.ndarray:
    """Current from which each current last turned back; the session comes from 0."""
    turned, last_A, now_A, rise = [], 0.0, 0.0, 0.0
    for current_A in CURRENT_A:
        step = np.sign(current_A - now_A)
        if step != 0.0:
            if rise not in (0.0, step):
                last_A = now_A
            rise = step
        now_A = current_A
        turned.append(last_A)
    return np.array(turned)


def came_from() -> np.ndarray:
    """Side to which the current last changed."""
    sides, side, now_A = [], 0.0, 0.0
    for current_A in CURRENT_A:
        side = np.sign(current_A - now_A) or side
        sides.append(side)
        now_A = current_A
    return np.array(sides)


def at_stop(number: int) -> np.ndarray:
    """Whether a reading is at the stop of a number, in the order of the places."""
    order = sorted(range(N), key=lambda i: tuple(POSITIONS_M[i]))
    return (np.arange(N) == order[number - 1]).astype(float)[:, None]


LOOSE = directions()[19].numpy()
EAST = dict(zip(("unit_x", "unit_y", "unit_z"), LOOSE.tolist(), strict=True))
LEVEL_T, GAIN_LEVEL_T = float(np.median(PLAIN_T[:, 2])), float(np.median(np.abs(PLAIN_T).max(axis=1)))

CASES: dict[str, tuple[Mapping[str, float], Formula]] = {
    "current_wanders[coil]": (
        {"degree1_share": 0.01, "degree2_share": -0.02, "duration_h": DURATION_H},
        lambda: (
            PLAIN_T
            * (1.0 + 0.01 * cosines(HOURS / DURATION_H, 1) - 0.02 * cosines(HOURS / DURATION_H, 2))[:, None]
        ),
    ),
    "current_swings[coil]": (
        {"degree1_cos": 0.01, "degree1_sin": 0.02, "frequency_per_h": 7.3},
        lambda: (
            PLAIN_T
            * (1.0 + 0.01 * np.cos(2 * np.pi * 7.3 * HOURS) + 0.02 * np.sin(2 * np.pi * 7.3 * HOURS))[:, None]
        ),
    ),
    "current_steps[coil]": (
        {"degree1_share": 0.01, "degree2_share": -0.02, "since1_h": 0.1, "since2_h": 0.3},
        lambda: PLAIN_T * (1.0 + 0.01 * from_instant(0.1) - 0.02 * from_instant(0.3)),
    ),
    "zero_steps[hall]": (
        {"degree1_x_T": 1e-5, "degree2_y_T": 2e-5, "since1_h": 0.1, "since2_h": 0.3},
        lambda: PLAIN_T + 1e-5 * from_instant(0.1) * UNIT[0] + 2e-5 * from_instant(0.3) * UNIT[1],
    ),
    "turns_wander[hall]": (
        {"degree0_x": 1e-3, "degree2_y": -2e-3, "duration_h": DURATION_H},
        lambda: (
            PLAIN_T
            + 1e-3 * np.cross(PLAIN_T, UNIT[0])
            - 2e-3 * cosines(HOURS / DURATION_H, 2)[:, None] * np.cross(PLAIN_T, UNIT[1])
        ),
    ),
    "response_steps[hall]": (
        {"degree1_x_z": 1e-3, "degree2_y_y": -2e-3, "since1_h": 0.1, "since2_h": 0.3},
        lambda: (
            PLAIN_T
            + 1e-3 * from_instant(0.1) * PLAIN_T[:, 2:] * UNIT[0]
            - 2e-3 * from_instant(0.3) * PLAIN_T[:, 1:2] * UNIT[1]
        ),
    ),
    "room_steps[room]": (
        {"degree1_x_T": 1e-5, "degree2_z_T": 2e-5, "since1_h": 0.1, "since2_h": 0.3},
        lambda: (
            PLAIN_T
            + SENSOR.inv().apply(1e-5 * from_instant(0.1) * UNIT[0] + 2e-5 * from_instant(0.3) * UNIT[2])
        ),
    ),
    "guides_step[arm]": (
        {"degree1_x_m": 1e-4, "degree2_z_m": -2e-4, "since1_h": 0.1, "since2_h": 0.3},
        lambda: predicted_T(shift_m=1e-4 * from_instant(0.1) * UNIT[0] - 2e-4 * from_instant(0.3) * UNIT[2]),
    ),
    "stop_errors[arm]": (
        {"degree1_x_m": 1e-4, "degree7_z_m": -2e-4},
        lambda: predicted_T(shift_m=1e-4 * at_stop(1) * UNIT[0] - 2e-4 * at_stop(7) * UNIT[2]),
    ),
    "sides_remembered[arm]": (
        {"degree1_y_m": 1e-4, "degree1_rx_m": 2e-4, "reach_m": 0.1, **EAST},
        lambda: predicted_T(
            shift_m=1e-4 * side_left(LOOSE) * UNIT[1], turn_rad=2e-3 * side_left(LOOSE) * UNIT[0]
        ),
    ),
    "current_remembered[coil]": (
        {
            "degree1_share": 0.01,
            "degree2_share": 0.02,
            "degree3_share": -0.03,
            "degree4_share": 0.04,
            "range_A": 3.0,
        },
        lambda: (
            PLAIN_T
            * (
                1.0
                + (
                    0.01 * np.abs(CURRENT_A)
                    + 0.06 * came_from()
                    - 0.03 * (np.append(0.0, CURRENT_A[:-1]) - CURRENT_A)
                    + 0.04 * largest_turned_A()
                )
                / CURRENT_A
            )[:, None]
        ),
    ),
    "field_remembered[hall]": (
        {"degree1_share": 0.01, "degree2_share": 0.02, "degree3_share": 0.03, "degree4_share": -0.04},
        lambda: (
            PLAIN_T
            + (0.01 + 0.02 * HOURS / DURATION_H)[:, None] * (before(RECORDED_T, 1) - PLAIN_T)
            + 0.03 * (before(RECORDED_T, 2) - before(RECORDED_T, 1))
            - 0.04 * (before(RECORDED_T, 3) - before(RECORDED_T, 2))
        ),
    ),
    "axis_steps[hall]": (
        {"degree1_step_T": 1e-5, "axis": 2.0, "above_T": LEVEL_T},
        lambda: PLAIN_T + 1e-5 * (PLAIN_T[:, 2:] > LEVEL_T) * UNIT[2],
    ),
    "gain_steps[hall]": (
        {"degree1_share": 0.01, "above_T": GAIN_LEVEL_T},
        lambda: PLAIN_T * (1.0 + 0.01 * (np.abs(PLAIN_T).max(axis=1, keepdims=True) > GAIN_LEVEL_T)),
    ),
    "room_answers[coil]": (
        {"degree1_cos0_T_per_A": 2e-6, "reach_m": 0.05},
        lambda: PLAIN_T + SENSOR.inv().apply(CURRENT_A[:, None] * np.array([0.0, 0.0, 2e-6])),
    ),
    "guides_wander[arm]": (
        {"degree1_x_m": 1e-4, "degree3_z_m": -2e-4, "duration_h": DURATION_H},
        lambda: predicted_T(
            shift_m=1e-4 * cosines(HOURS / DURATION_H, 1)[:, None] * UNIT[0]
            - 2e-4 * cosines(HOURS / DURATION_H, 3)[:, None] * UNIT[2]
        ),
    ),
    "guide_swings[arm]": (
        {"degree1_x_cos_m": 1e-4, "degree2_y_sin_m": 3e-4, "frequency_per_m": 80.0},
        lambda: predicted_T(
            shift_m=1e-4 * np.cos(2 * np.pi * 80.0 * POSITIONS_M[:, :1]) * UNIT[0]
            + 3e-4 * np.sin(4 * np.pi * 80.0 * POSITIONS_M[:, 1:2]) * UNIT[1]
        ),
    ),
    "moves_remembered[arm]": (
        {"degree1_z_after_x_m": 1e-4, "degree3_x_after_y_m": 2e-4, "move_m": 0.02, "reach_m": 0.1},
        lambda: predicted_T(
            shift_m=1e-4 * MOVES_M[:, :1] / 0.02 * UNIT[2]
            + 2e-4 * (HOURS / DURATION_H)[:, None] * MOVES_M[:, 1:2] / 0.02 * UNIT[0]
        ),
    ),
    "response_by_place[hall]": (
        {
            "degree1_x_along_z_T": 1e-5,
            "degree2_gain_y_along_x_T": 2e-5,
            "range_T": 0.004,
            **{f"from_{axis}_m": -0.03 for axis in "xyz"},
            **{f"span_{axis}_m": 0.06 for axis in "xyz"},
        },
        lambda: (
            PLAIN_T
            + 1e-5 * cosines((POSITIONS_M[:, 2:] + 0.03) / 0.06, 1) * UNIT[0]
            + 2e-5 * cosines((POSITIONS_M[:, :1] + 0.03) / 0.06, 2) * PLAIN_T / 0.004 * UNIT[1]
        ),
    ),
    "zero_swings[hall]": (
        {"degree1_y_cos_T": 1e-5, "degree2_z_sin_T": 2e-5, "frequency_per_h": 7.3},
        lambda: (
            PLAIN_T
            + 1e-5 * np.cos(2 * np.pi * 7.3 * HOURS)[:, None] * UNIT[1]
            + 2e-5 * np.sin(4 * np.pi * 7.3 * HOURS)[:, None] * UNIT[2]
        ),
    ),
    "reading_ripples[hall]": (
        {"degree1_x_cos_T": 1e-5, "degree1_y_sin_T": 2e-5, "frequency_per_T": 700.0},
        lambda: (
            PLAIN_T
            + 1e-5 * np.cos(2 * np.pi * 700.0 * PLAIN_T[:, :1]) * UNIT[0]
            + 2e-5 * np.sin(2 * np.pi * 700.0 * PLAIN_T[:, 1:2]) * UNIT[1]
        ),
    ),
    "axis_curves[hall]": (
        {"degree3_y_T": 1e-5, "range_T": 0.004},
        lambda: PLAIN_T + 1e-5 * cosines(0.5 * (PLAIN_T[:, 1:2] / 0.004 + 1.0), 3) * UNIT[1],
    ),
    "current_pickup[hall]": (
        {"degree1_x_T": 1e-5, "degree2_z_T": 2e-5, "range_A": 3.0},
        lambda: (
            PLAIN_T
            + 1e-5 * CURRENT_A[:, None] / 3.0 * UNIT[0]
            + 2e-5 * (CURRENT_A[:, None] / 3.0) ** 2 * UNIT[2]
        ),
    ),
    "gain_curve[hall]": (
        {"degree2_share": 0.01, "range_T": 0.004},
        lambda: PLAIN_T * (1.0 + 0.01 * cosines(np.abs(PLAIN_T).max(axis=1) / 0.004, 2))[:, None],
    ),
}


@pytest.mark.parametrize("label", CASES)
def test_a_corrected_reading_is_the_one_worked_out_by_hand(label):
    values, by_hand = CASES[label]
    name, _, place = label.removesuffix("]").partition("[")
    corrected_T, wanted_T = predicted_T((Cause(name, place), values)), by_hand()
    assert np.abs(wanted_T - PLAIN_T).max() > 1e-7
    np.testing.assert_allclose(corrected_T, wanted_T, rtol=1e-6, atol=1e-12)


def test_a_loose_mount_turns_to_the_side_from_which_it_came():
    arc_m, reach_m = 2e-4, 0.1
    numbers = {"degree2_rx_after_y_m": arc_m, "move_m": 0.02, "reach_m": reach_m}
    corrected_T = predicted_T((Cause("moves_remembered", "arm"), numbers))
    turn_rad = arc_m / reach_m * np.sign(MOVES_M[:, 1:2]) * UNIT[0]
    np.testing.assert_allclose(corrected_T, predicted_T(turn_rad=turn_rad), rtol=1e-6, atol=1e-12)
    assert np.abs(corrected_T - PLAIN_T).max() > 1e-7
