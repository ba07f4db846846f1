"""Effects of the room: what is there without current, and iron that answers the coils, against image currents and induced dipoles."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.units import MU0_T_M_PER_A
from tests.physics.effects.laboratory import (
    POINTS_M,
    RIG,
    added_T,
    assert_same_field,
    dipole_T,
    polyline_T,
    predicted_T,
    readings,
    winding,
)

ONE = readings(POINTS_M, (1.0, 0.0))
EARTH = {"x_T": 20e-6, "y_T": -1e-6, "z_T": 43e-6}
EARTH_T = np.array(list(EARTH.values()))
TURNS_RAD = Rotation.random(len(POINTS_M), rng=np.random.default_rng(4)).as_rotvec()


def test_background_field_stands_still_in_the_room_whatever_the_current():
    currents = np.stack((np.linspace(-3.0, 3.0, len(POINTS_M)), np.zeros(len(POINTS_M))), axis=1)
    found = added_T(readings(POINTS_M, currents), {"background_field[room]": EARTH})
    np.testing.assert_allclose(found, np.broadcast_to(EARTH_T, found.shape), rtol=0.0, atol=1e-15)


def test_turned_sensor_sees_the_background_turned_the_other_way_and_its_own_offset_not():
    turned = readings(POINTS_M, (1.0, 0.0), turn_rad=TURNS_RAD)
    found = added_T(turned, {"background_field[room]": EARTH})
    expected = Rotation.from_rotvec(TURNS_RAD).inv().apply(EARTH_T)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-15)
    offset = added_T(turned, {"sensor_offset[probe]": EARTH})
    np.testing.assert_allclose(offset, np.broadcast_to(EARTH_T, offset.shape), rtol=0.0, atol=1e-15)


def test_background_drifts_in_proportion_to_the_hours_since_the_session_began():
    rate = {"x_T_per_h": 1e-5, "y_T_per_h": 0.0, "z_T_per_h": -3e-5}
    time_s = 1.7e9 + np.array([0.0, 360.0, 720.0, 3600.0, 4000.0, 7200.0, 9000.0])
    turned = readings(POINTS_M, (1.0, 0.0), turn_rad=TURNS_RAD, time_s=time_s)
    found = added_T(turned, {"background_drift[room]": rate})
    in_room = (time_s - time_s[0])[:, None] / 3600.0 * np.array(list(rate.values()))
    np.testing.assert_allclose(
        found, Rotation.from_rotvec(TURNS_RAD).inv().apply(in_room), rtol=0.0, atol=1e-14
    )


def test_background_drift_is_zero_at_the_beginning_of_the_session_not_of_its_part():
    time_s = 600.0 * np.arange(len(POINTS_M))
    part = readings(POINTS_M, (1.0, 0.0), time_s=time_s)
    kept = part.rows(part.time_s >= 1800.0)
    found = added_T(kept, {"background_drift[room]": {"z_T_per_h": 1e-5}})[:, 2]
    np.testing.assert_allclose(found, 1e-5 * time_s[3:] / 3600.0, rtol=1e-9, atol=1e-18)


AZIMUTH, ELEVATION, DISTANCE_M = 0.7, -0.4, 0.11
ACROSS = np.array(
    [
        np.cos(ELEVATION) * np.cos(AZIMUTH),
        np.cos(ELEVATION) * np.sin(AZIMUTH),
        np.sin(ELEVATION),
    ]
)
PLATE = {"strength": 1.0, "azimuth_rad": AZIMUTH, "elevation_rad": ELEVATION, "distance_m": DISTANCE_M}


def mirrored(points_m: np.ndarray) -> np.ndarray:
    return points_m - 2.0 * ((points_m @ ACROSS) - DISTANCE_M)[:, None] * ACROSS


def image_T(points_m: np.ndarray, shift_m: np.ndarray) -> np.ndarray:
    """Mirrored wires; what runs along the plate keeps its direction in the image, what runs towards it is reversed."""
    phi = np.linspace(0.0, 2.0 * np.pi, 361)
    loops = winding()
    total = np.zeros_like(points_m)
    for a, z in zip(loops.radius_m, loops.height_m, strict=True):
        wire_m = np.stack((a * np.cos(phi), a * np.sin(phi), np.full_like(phi, z)), axis=1) + shift_m
        total += polyline_T(mirrored(wire_m), points_m)
    return total


@pytest.mark.parametrize("strength", [1.0, 0.25, -0.5])
def test_iron_plate_adds_the_field_of_image_currents(strength):
    """Polygons of 360 sides differ from circles by 1e-4."""
    found = added_T(ONE, {"iron_plate[room]": {**PLATE, "strength": strength}})
    assert_same_field(found, strength * image_T(POINTS_M, np.zeros(3)), 2e-4)


def test_field_at_a_plate_of_soft_iron_stands_upright_on_it():
    flat = np.linalg.svd(ACROSS[None])[2][1:]
    on_plate_m = DISTANCE_M * ACROSS + np.random.default_rng(2).normal(0.0, 0.05, (8, 2)) @ flat
    just_before_m = on_plate_m - 1e-12 * ACROSS
    field = predicted_T(readings(just_before_m, (1.0, 0.0)), {"iron_plate[room]": PLATE})
    alone = winding().field_T(on_plate_m)
    assert np.abs(field @ flat.T).max() < 1e-9 * np.abs(field).max()
    np.testing.assert_allclose(field @ ACROSS, 2.0 * (alone @ ACROSS), rtol=1e-9)


def test_behind_a_sheet_of_iron_the_share_passes_that_is_not_reflected_and_the_field_along_the_sheet_is_continuous():
    """No current flows in the sheet, so the tangential field is the same on both sides; the flux that is missing runs in the sheet."""
    flat = np.linalg.svd(ACROSS[None])[2][1:]
    at_m = DISTANCE_M * ACROSS + np.random.default_rng(2).normal(0.0, 0.05, (8, 2)) @ flat
    sheet = {"iron_plate[room]": {**PLATE, "strength": 0.3}}
    front, behind = (predicted_T(readings(at_m + side * ACROSS, (1.0, 0.0)), sheet) for side in (-1e-9, 1e-9))
    np.testing.assert_allclose(behind, 0.7 * winding().field_T(at_m), rtol=1e-6)
    np.testing.assert_allclose(front @ flat.T, behind @ flat.T, rtol=1e-6, atol=1e-6 * np.abs(front).max())
    assert np.abs((front - behind) @ ACROSS).min() > 0.1 * np.abs(front @ ACROSS).min()


CARRIED = (
    RIG.replace("  coil: {radius_mm", "  coil: {carried_by: arm, radius_mm")
    .replace("{mapper: {motion: pose}}", "{arm: {motion: displacement}}")
    .replace("carried_by: mapper, noise", "noise")
)


def test_image_follows_the_coil_that_moves():
    shifts_m = np.array([[0.0, 0.01, -0.04], [0.02, 0.0, -0.05], [-0.01, 0.02, -0.06]])
    moved = readings(shifts_m, (1.0, 0.0), mover="arm")
    expected = np.concatenate([image_T(np.zeros((1, 3)), shift_m) for shift_m in shifts_m])
    assert_same_field(added_T(moved, {"iron_plate[room]": PLATE}, CARRIED), expected, 2e-4)


BODY_M, BALL_M = np.array([0.05, -0.06, 0.03]), 0.012
BODY = {"volume_m3": BALL_M**3, "x_m": BODY_M[0], "y_m": BODY_M[1], "z_m": BODY_M[2]}


def test_iron_body_answers_as_the_dipole_that_a_ball_of_iron_becomes():
    """A ball of large permeability in a field B0 has the moment 4 pi a^3 B0 / mu0 (Jackson, section 5.11)."""
    moment = 4.0 * np.pi * BALL_M**3 / MU0_T_M_PER_A * winding().field_T(BODY_M[None])[0]
    assert_same_field(added_T(ONE, {"iron_body[room]": BODY}), dipole_T(moment, BODY_M, POINTS_M))


def test_iron_body_answers_every_coil_by_its_current():
    both, first, second = (
        added_T(readings(POINTS_M, current_A), {"iron_body[room]": BODY})
        for current_A in ((2.0, -3.0), (2.0, 0.0), (0.0, -3.0))
    )
    assert_same_field(both, first + second, 1e-9)
    assert (np.linalg.norm(second, axis=1) > 1e-2 * np.linalg.norm(first, axis=1)).all()


def test_flux_at_the_poles_of_a_small_ball_of_iron_is_three_times_the_field():
    """And none runs along its surface at the equator."""
    radius_m = 1e-4
    field = winding().field_T(BODY_M[None])[0]
    along = field / np.linalg.norm(field)
    across = np.linalg.svd(along[None])[2][1]
    surface_m = BODY_M + radius_m * np.stack((along, -along, across))
    ball = {**BODY, "volume_m3": radius_m**3}
    total = predicted_T(readings(surface_m, (1.0, 0.0)), {"iron_body[room]": ball})
    np.testing.assert_allclose(total @ along / np.linalg.norm(field), [3.0, 3.0, 0.0], rtol=0.0, atol=0.02)


def test_iron_body_answers_the_coil_where_it_stands_now():
    shifts_m = np.array([[0.0, 0.01, -0.04], [0.02, 0.0, -0.05]])
    moved = readings(shifts_m, (1.0, 0.0), mover="arm")
    expected = []
    for shift_m in shifts_m:
        at_body = winding().field_T((BODY_M - shift_m)[None])[0]
        moment = 4.0 * np.pi * BALL_M**3 / magpylib.mu_0 * at_body
        expected.append(dipole_T(moment, BODY_M, np.zeros((1, 3)))[0])
    assert_same_field(added_T(moved, {"iron_body[room]": BODY}, CARRIED), np.array(expected), 1e-8)
