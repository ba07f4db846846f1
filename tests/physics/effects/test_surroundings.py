"""Effects of the room: what is there without current, and iron that answers the coils, against image currents and induced dipoles."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.model.room_field import RoomField
from estimator.rig.coordinates import nominal_tensors
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import POINTS_M, RIG, added_T, effects_text, readings

EARTH = {"x_T": 20e-6, "y_T": -1e-6, "z_T": 43e-6}
EARTH_T = np.array(list(EARTH.values()))
TURNS_RAD = Rotation.random(len(POINTS_M), rng=np.random.default_rng(4)).as_rotvec()


def test_a_gradient_is_that_of_a_magnet_far_away():
    """The matrix of slopes of a dipole 2 m away at the origin, by the derivative of its field worked out by hand."""
    moment_A_m2, away_m = np.array([300.0, -200.0, 500.0]), np.array([1.2, -1.4, 0.8])

    def dipole_T(points_m: np.ndarray) -> np.ndarray:
        from_m = points_m - away_m
        distance_m = np.linalg.norm(from_m, axis=-1, keepdims=True)
        along = 3.0 * from_m * (from_m @ moment_A_m2)[..., None] / distance_m**5
        return 1e-7 * (along - moment_A_m2 / distance_m**3)

    r_m, m = -away_m, moment_A_m2
    distance_m = np.linalg.norm(r_m)
    mixed = (
        np.outer(r_m, m)
        + np.outer(m, r_m)
        + (r_m @ m) * (np.eye(3) - 5.0 * np.outer(r_m, r_m) / distance_m**2)
    )
    slopes = 3e-7 * mixed / distance_m**5
    size = {
        f"{'xyz'[i]}{'xyz'[j]}_T_per_m": slopes[i, j] for i, j in ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))
    }
    found_T = added_T(readings(POINTS_M, (1.0, 0.0)), {"background_gradient[room]": size})
    near = 0.02  # of the way to each point: there the field is straight
    expected_T = (dipole_T(near * POINTS_M) - dipole_T(np.zeros(3))) / near
    np.testing.assert_allclose(found_T, expected_T, rtol=0.0, atol=2e-3 * np.abs(expected_T).max())


def test_background_drift_is_zero_at_the_beginning_of_the_session_not_of_its_part():
    time_s = 600.0 * np.arange(len(POINTS_M))
    part = readings(POINTS_M, (1.0, 0.0), time_s=time_s)
    second_half = part.rows(part.time_s >= 1800.0)
    difference_T = added_T(second_half, {"background_drift[room]": {"z_T_per_h": 1e-5}})[:, 2]
    np.testing.assert_allclose(difference_T, 1e-5 * time_s[3:] / 3600.0, rtol=1e-9, atol=1e-18)


def test_interference_swings_about_its_phase_at_the_beginning_of_the_session():
    """An amplitude times the cosine of the angle past a phase, in the room, the same for a part of the session."""
    time_s = 1.7e9 + np.array([0.0, 100.0, 250.0, 300.0, 700.0, 1000.0, 3600.0])
    period_s, amplitude_T, phase_rad = 900.0, np.array([3e-5, 0.0, -1e-5]), 0.7
    given = {f"cos_{axis}_T": a * np.cos(phase_rad) for axis, a in zip("xyz", amplitude_T, strict=True)}
    given |= {f"sin_{axis}_T": a * np.sin(phase_rad) for axis, a in zip("xyz", amplitude_T, strict=True)}
    given["frequency_per_h"] = 3600.0 / period_s
    turned = readings(POINTS_M, (1.0, 0.0), turn_rad=TURNS_RAD, time_s=time_s)
    difference_T = added_T(turned, {"periodic_interference[room]": given})
    angle = 2.0 * np.pi * (time_s - time_s[0]) / period_s - phase_rad
    expected = Rotation.from_rotvec(TURNS_RAD).inv().apply(np.cos(angle)[:, None] * amplitude_T)
    np.testing.assert_allclose(difference_T, expected, rtol=0.0, atol=1e-14)
    later = turned.rows(turned.time_s > time_s[2])
    part_T = added_T(later, {"periodic_interference[room]": given})
    np.testing.assert_allclose(part_T, expected[3:], rtol=0.0, atol=1e-14)


def test_interference_is_looked_for_up_to_half_a_cycle_between_readings_and_160_in_a_session():
    effect, rig = EFFECTS["periodic_interference"], rig_from_text(RIG)
    for n, n_starts in ((7, 6), (101, 100), (400, 320)):
        session = readings(np.repeat(POINTS_M[:1], n, axis=0), time_s=60.0 * np.arange(n))
        starts = effect.starts(Circumstances(rig, session), "room")
        cycles = [start["frequency_per_h"] * (n - 1) / 60.0 for start in starts]
        np.testing.assert_allclose(cycles, 0.5 * np.arange(1, n_starts + 1))


def test_prediction_has_no_phase_of_the_interference():
    effects = effects_text({"periodic_interference[room]": {"cos_z_T": 1e-4, "frequency_per_h": 2.0}})
    fields_T = []
    for text in (RIG, RIG + effects):
        rig = rig_from_text(text)
        values, points_m = nominal_tensors(rig), torch.from_numpy(POINTS_M)
        fields_T.append(RoomField(rig, values, points_m).field_T(values, torch.ones(2, dtype=torch.float64)))
    torch.testing.assert_close(*fields_T, rtol=0.0, atol=0.0)


def test_step_of_the_room_and_of_a_zero_differ_once_the_sensor_turns():
    """From half of the session on: the room's turns into the frame of the sensor, the sensor's own zero does not."""
    time_s = 1.7e9 + 600.0 * np.arange(len(POINTS_M))
    turned = readings(POINTS_M, (1.0, 0.0), turn_rad=TURNS_RAD, time_s=time_s)
    later = (np.arange(len(POINTS_M)) >= 4)[:, None]
    since = {"since_h": 3.5 * 600.0 / 3600.0}
    room_T = added_T(turned, {"background_step[room]": {**EARTH, **since}})
    in_sensor_T = Rotation.from_rotvec(TURNS_RAD).inv().apply(EARTH_T)
    np.testing.assert_allclose(room_T, later * in_sensor_T, rtol=0.0, atol=1e-15)
    zero_T = added_T(turned, {"offset_step[probe]": {**EARTH, **since}})
    np.testing.assert_allclose(zero_T, later * EARTH_T, rtol=0.0, atol=1e-15)
