"""Iron that answers the coils: against image currents, the potential problem of a sheet with a hole, and induced dipoles."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.causes.iron import iron_body, iron_plate, pierced_plate
from estimator.effects.circumstances import Circumstances
from estimator.rig_files.read import rig_from_text
from estimator.units import MU0_T_M_PER_A
from tests.hidden.pierced_sheet import pierced_T
from tests.physics.effects.laboratory import (
    POINTS_M,
    RIG,
    added_T,
    assert_same_field,
    dipole_T,
    effects_text,
    polyline_T,
    predicted_T,
    readings,
    winding,
)

pytestmark = pytest.mark.whole

# A coil that is carried with the sensor, so that the whole laboratory may lie anywhere.
FAR = """
schema_version: 1
name: elsewhere
movers: {mapper: {motion: pose}}
coils: {coil: {radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 6, radial_loops: 4, carried_by: mapper}}
sensors: {probe: {carried_by: mapper, noise_uT: 5}}
"""
ONE = readings(POINTS_M, (1.0, 0.0))

TILTS_RAD, DISTANCE_M = (0.7, -0.4), 0.11
ACROSS = np.array(  # from the x axis towards y and z
    [
        np.cos(TILTS_RAD[0]) * np.cos(TILTS_RAD[1]),
        np.sin(TILTS_RAD[0]),
        np.cos(TILTS_RAD[0]) * np.sin(TILTS_RAD[1]),
    ]
)
TILTED = {"axis": 0.0, "tilt_1_rad": TILTS_RAD[0], "tilt_2_rad": TILTS_RAD[1]}
PLATE = {"strength": 1.0, **TILTED, "distance_m": DISTANCE_M}


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
    difference_T = added_T(ONE, {"iron_plate[room]": {**PLATE, "strength": strength}})
    assert_same_field(difference_T, strength * image_T(POINTS_M, np.zeros(3)), 2e-4)


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


OPENING_M = 0.025
# Normal along the coil's axis, beyond the winding's front.
PIERCED = {
    "strength": 1.0,
    "axis": 2.0,
    "tilt_1_rad": 0.0,
    "tilt_2_rad": 0.0,
    "x_m": 0.0,
    "y_m": 0.0,
    "z_m": 0.08,
    "radius_m": OPENING_M,
}
AROUND_M = np.array(  # before, in, and behind the opening, and beside it
    [
        [0.0, 0.0, 0.05],
        [0.04, -0.01, 0.07],
        [0.0, 0.0, 0.083],
        [0.01, 0.012, 0.077],
        [-0.014, 0.003, 0.083],
        [-0.01, 0.0, 0.12],
        [0.05, 0.02, 0.10],
    ]
)


def test_pierced_plate_is_the_exact_solution_where_the_opening_is_small_against_the_coils_distance():
    """The field in the opening is taken to its second power, hence the error falls as the fourth power of the opening."""
    errors = []
    for radius_m in (OPENING_M, 0.5 * OPENING_M):
        middle_m = np.array([0.0, 0.0, 0.08])
        at_m = middle_m + (AROUND_M - middle_m) * radius_m / OPENING_M
        reading_T = predicted_T(
            readings(at_m, (1.0, 0.0)), {"pierced_plate[room]": {**PIERCED, "radius_m": radius_m}}
        )
        exact = pierced_T(winding().field_T, 0.08, radius_m, at_m)
        errors.append(np.linalg.norm(reading_T - exact, axis=1) / np.linalg.norm(exact, axis=1))
    assert errors[0].max() < 1e-2
    assert errors[1].max() < 1e-1 * errors[0].max()


def test_flux_through_the_opening_is_continuous_and_half_of_what_the_sheet_would_carry():
    at_m = np.array([[0.0, 0.0], [0.01, 0.0], [-0.012, 0.015]])
    front, behind = (
        predicted_T(
            readings(np.column_stack((at_m, np.full(3, 0.08 + side))), (1.0, 0.0)),
            {"pierced_plate[room]": PIERCED},
        )
        for side in (-1e-10, 1e-10)
    )
    assert_same_field(front, behind, 5e-3)
    assert_same_field(front[:1], behind[:1], 1e-7)
    alone = winding().field_T(np.array([[0.0, 0.0, 0.08]]))[0]
    np.testing.assert_allclose(front[0], alone, rtol=1e-6, atol=1e-6 * np.abs(alone).max())


def test_field_at_a_pierced_plate_stands_upright_on_both_of_its_sides():
    at_m = np.array([[0.03, 0.0], [0.0, -0.05], [0.06, 0.04]])
    for side in (-1e-9, 1e-9):
        on_m = np.column_stack((at_m, np.full(3, 0.08 + side)))
        field = predicted_T(readings(on_m, (1.0, 0.0)), {"pierced_plate[room]": PIERCED})
        assert np.abs(field[:, :2]).max() < 1e-5 * np.abs(field[:, 2]).min()


def test_step_of_the_rooms_field_goes_through_the_opening_as_the_potential_problem_has_it():
    """The room's field as that of a far source in front of the sheet, less half of it everywhere."""
    step_T = 3e-4
    difference_T = added_T(
        readings(AROUND_M, (0.0, 0.0)),
        {"pierced_plate[room]": {**PIERCED, "strength": 0.0, "step_T": step_T}},
    )
    half_T = np.array([0.0, 0.0, -0.5 * step_T])  # larger behind, which is where the normal points
    exact = pierced_T(lambda at_m: np.broadcast_to(half_T, at_m.shape), 0.08, OPENING_M, AROUND_M) - half_T
    assert_same_field(difference_T, exact, 1e-4)


@pytest.mark.parametrize(("x_m", "is_itself"), [(0.0, True), (0.02, True), (0.3, False), (20.0, False)])
def test_sensors_went_through_the_opening_of_a_pierced_plate(x_m, is_itself):
    """A search took a plate for one whose opening was five maps away."""
    circumstances = Circumstances(rig_from_text(RIG), readings(AROUND_M))
    theta = {key: torch.tensor(value, dtype=torch.float64) for key, value in (PIERCED | {"x_m": x_m}).items()}
    assert pierced_plate.is_itself(theta, circumstances) is is_itself


@pytest.mark.parametrize(
    ("height_m", "is_between"), [(0.08, True), (0.117, True), (0.3, False), (-3.0, False)]
)
def test_pierced_plate_beside_all_readings_is_a_field_of_the_room_and_no_plate(height_m, is_between):
    """As a search took one for it, in an axis scan of a coil with a background of 77 uT."""
    circumstances = Circumstances(rig_from_text(RIG), readings(AROUND_M))
    theta = {
        key: torch.tensor(value, dtype=torch.float64) for key, value in (PIERCED | {"z_m": height_m}).items()
    }
    assert pierced_plate.is_itself(theta, circumstances) is is_between
    if not is_between:
        field = added_T(
            readings(AROUND_M, (0.0, 0.0)),
            {"pierced_plate[room]": {**PIERCED, "z_m": 100.0 * height_m, "strength": 0.0, "step_T": 3e-4}},
        )
        assert_same_field(field, np.broadcast_to([0.0, 0.0, -np.sign(height_m) * 1.5e-4], field.shape), 1e-6)


def test_a_tiny_opening_leaves_the_plate():
    tiny = {"pierced_plate[room]": {**PIERCED, "z_m": 0.2, "radius_m": 1e-5}}
    whole = {
        "iron_plate[room]": {
            "strength": 1.0,
            "axis": 2.0,
            "tilt_1_rad": 0.0,
            "tilt_2_rad": 0.0,
            "distance_m": 0.2,
        }
    }
    assert_same_field(added_T(ONE, tiny), added_T(ONE, whole), 1e-6)


def test_pierced_plate_is_the_same_described_from_its_other_side_and_in_proportion_to_its_strength():
    at = readings(AROUND_M, (1.0, 0.0))
    difference_T = added_T(at, {"pierced_plate[room]": PIERCED})
    quarter_rad = 0.5 * np.pi
    for described in (
        {"tilt_2_rad": np.pi},
        {"axis": 0.0, "tilt_2_rad": quarter_rad},
        {"axis": 1.0, "tilt_1_rad": -quarter_rad},
    ):
        assert_same_field(added_T(at, {"pierced_plate[room]": {**PIERCED, **described}}), difference_T, 1e-7)
    half = added_T(at, {"pierced_plate[room]": {**PIERCED, "strength": 0.5}})
    assert_same_field(half, 0.5 * difference_T, 1e-9)


def test_opening_lets_through_the_field_of_a_tilted_coil():
    """What is antisymmetric about the axis is left out: the flux in the middle and its continuity stay."""
    tilted = RIG.replace("radius_mm: 40,", "radius_mm: 40, world_from_coil: {rx_deg: 20},")
    at_m = np.array([[0.004, -0.003, 0.08 - 1e-9], [0.004, -0.003, 0.08 + 1e-9]])
    front, behind = predicted_T(readings(at_m, (1.0, 0.0)), {"pierced_plate[room]": PIERCED}, tilted)
    np.testing.assert_allclose(front[2], behind[2], rtol=0.15)


BODY_M, BALL_M = np.array([0.05, -0.06, 0.03]), 0.012
BODY = {"volume_m3": BALL_M**3, "x_m": BODY_M[0], "y_m": BODY_M[1], "z_m": BODY_M[2]}


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


def test_a_piece_of_iron_is_looked_for_around_the_session_wherever_the_world_begins():
    far_m = np.array([2.0, -1.0, 5.0])
    here, there = (
        Circumstances(rig_from_text(FAR), readings(POINTS_M + m, (1.0,))) for m in (np.zeros(3), far_m)
    )
    for axis, shift_m in zip("xyz", far_m, strict=True):
        near, far = (
            next(q.prior for q in iron_body.quantities(circumstances.extent) if q.key == f"{axis}_m")
            for circumstances in (here, there)
        )
        assert far.lower - near.lower == pytest.approx(shift_m, abs=1e-9)
        assert far.upper - near.upper == pytest.approx(shift_m, abs=1e-9)


def test_iron_body_answers_the_coil_where_it_stands_now():
    shifts_m = np.array([[0.0, 0.01, -0.04], [0.02, 0.0, -0.05]])
    moved = readings(shifts_m, (1.0, 0.0), mover="arm")
    expected = []
    for shift_m in shifts_m:
        at_body = winding().field_T((BODY_M - shift_m)[None])[0]
        moment = 4.0 * np.pi * BALL_M**3 / magpylib.mu_0 * at_body
        expected.append(dipole_T(moment, BODY_M, np.zeros((1, 3)))[0])
    assert_same_field(added_T(moved, {"iron_body[room]": BODY}, CARRIED), np.array(expected), 1e-8)


def test_second_body_answers_the_coils_as_the_first_would_and_not_the_first():
    second = {**BODY, "x_m": -0.05}
    both_T = added_T(ONE, {"iron_body[room]": BODY, "second_iron_body[room]": second})
    one_by_one_T = added_T(ONE, {"iron_body[room]": BODY}) + added_T(ONE, {"iron_body[room]": second})
    assert_same_field(both_T, one_by_one_T)


def test_second_body_is_looked_for_beside_a_first_alone():
    without = rig_from_text(RIG)
    beside = rig_from_text(RIG + effects_text({"iron_body[room]": BODY}))
    asked = [
        EFFECTS["second_iron_body"].concerns(Circumstances(rig, ONE), "room") for rig in (without, beside)
    ]
    assert asked == [False, True]


@pytest.mark.parametrize(("share", "is_clear"), [(-0.2, True), (0.4, False), (6.0, True)])
def test_a_plate_is_itself_while_no_sensor_went_through_it(share, is_clear):
    turned = {"axis": 0.0, "tilt_1_rad": TILTS_RAD[0], "tilt_2_rad": TILTS_RAD[1]}
    along_m = POINTS_M @ ACROSS
    distance_m = along_m.min() + share * np.ptp(along_m)
    theta = {
        key: torch.tensor(value, dtype=torch.float64)
        for key, value in (turned | {"distance_m": distance_m}).items()
    }
    assert iron_plate.is_itself(theta, Circumstances(rig_from_text(RIG), ONE)) is is_clear


# The coil's winding ends 6 mm below z = 0; the other coil lies on its side and reaches down to 30 mm.
@pytest.mark.parametrize(
    ("height_m", "is_clear"), [(-0.003, False), (-0.02, False), (-0.031, True), (0.032, True)]
)
def test_a_plate_is_itself_while_no_winding_is_on_both_of_its_sides(height_m, is_clear):
    in_front = readings(POINTS_M[:2], (1.0, 0.0))
    circumstances = Circumstances(rig_from_text(RIG), in_front)
    numbers = {"axis": 2.0, "tilt_1_rad": 0.0, "tilt_2_rad": 0.0, "distance_m": height_m}
    theta = {key: torch.tensor(value, dtype=torch.float64) for key, value in numbers.items()}
    assert iron_plate.is_itself(theta, circumstances) is is_clear


def test_plates_are_looked_for_where_nothing_is_in_their_way():
    circumstances = Circumstances(rig_from_text(RIG), readings(POINTS_M[:2], (1.0, 0.0)))
    starts = iron_plate.starts(circumstances)
    assert len(starts) == 12
    for start in starts:
        theta = {key: torch.tensor(value, dtype=torch.float64) for key, value in start.items()}
        assert iron_plate.is_itself(theta, circumstances)


@pytest.mark.parametrize("name", ["iron_core", "core_saturation", "cross_magnetisation", "dipole_model"])
@pytest.mark.parametrize(("height_m", "is_free"), [(0.001, True), (-0.003, False), (-0.007, True)])
def test_iron_fills_no_bore_that_a_sensor_went_through(name, height_m, is_free):
    circumstances = Circumstances(
        rig_from_text(RIG), readings(np.array([[0.01, 0.0, 0.03], [0.02, 0.01, height_m]]), (1.0, 2.0))
    )
    assert EFFECTS[name].concerns(circumstances, "coil") is is_free


def test_iron_on_the_sensor_is_magnetised_where_the_sensor_takes_it():
    """Coil and room magnetise it alike: a dipole of magpylib for every reading, beside a sensor that turns."""
    turns = Rotation.random(len(POINTS_M), rng=np.random.default_rng(8))
    beside_m, radius_m = np.array([0.004, -0.007, 0.009]), 2.5e-3
    room_T = np.array([1e-5, 0.0, 4e-5])
    there_m = POINTS_M + turns.apply(beside_m)
    moments_A_m2 = 4.0 * np.pi * radius_m**3 / MU0_T_M_PER_A * (3.0 * winding().field_T(there_m) + room_T)
    of_iron_T = np.concatenate(
        [
            dipole_T(moment, there, at[None])
            for moment, there, at in zip(moments_A_m2, there_m, POINTS_M, strict=True)
        ]
    )
    iron = {"radius_cubed_m3": radius_m**3, **dict(zip(("x_m", "y_m", "z_m"), beside_m, strict=True))}
    field = {"background_field[room]": {"x_T": room_T[0], "z_T": room_T[2]}}
    turned = readings(POINTS_M, (3.0, 0.0), turn_rad=turns.as_rotvec())
    both_T = predicted_T(turned, {"iron_on_sensor[probe]": iron, **field})
    assert_same_field(both_T - predicted_T(turned, field), turns.inv().apply(of_iron_T), rtol=1e-8)


def test_iron_beside_a_sensor_that_stands_still_stands_in_the_room():
    iron = EFFECTS["iron_on_sensor"]
    rig = rig_from_text(RIG)
    assert iron.concerns(Circumstances(rig, ONE), "probe")
    still = readings(np.repeat(POINTS_M[:1], 5, axis=0), (1.0, 0.0))
    assert not iron.concerns(Circumstances(rig, still), "probe")
    fixed = rig_from_text(RIG.replace("carried_by: mapper, noise", "world_from_sensor: {x_mm: 10}, noise"))
    assert not iron.concerns(Circumstances(fixed, ONE), "probe")
