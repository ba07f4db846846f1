"""Effects of winding, leads and core against explicit sums of magpylib's loops, pieces of wire and magnets."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest

from estimator.effects.causes import coil as causes_of_coil
from tests.physics.effects.laboratory import (
    MU0_RATIO,
    POINTS_M,
    RIG,
    Loops,
    added_T,
    assert_same_field,
    dipole_T,
    polyline_T,
    predicted_T,
    readings,
    winding,
)

PITCH_M, LENGTH_M = 1e-3, 6e-3
# Pieces of wire and few nodes are not the code's loops: points farther from them than from ideal loops.
FAR_M = POINTS_M[[1, 2, 4, 6]] * 1.6
ONE = readings(POINTS_M, (1.0, 0.0))
ONE_FAR = readings(FAR_M, (1.0, 0.0))


@pytest.mark.parametrize("at_front", [1.0, 0.0])
@pytest.mark.parametrize("n_missing", [1, 4])
def test_short_layer_is_the_winding_without_some_turns_of_its_outermost_layer(at_front, n_missing):
    """What is missing is smeared along the axis so that its share need not be whole turns: 2e-3 of it at these points."""
    loops = winding()
    outermost = loops.radius_m == loops.radius_m.max()
    order = np.argsort(loops.height_m[outermost])
    gone = np.flatnonzero(outermost)[order[-n_missing:] if at_front else order[:n_missing]]
    missing = Loops(loops.radius_m[gone], loops.height_m[gone], -np.ones(n_missing))
    effect = {"short_layer[coil]": {"missing": n_missing / 6, "at_front": at_front}}
    assert_same_field(added_T(ONE_FAR, effect), missing.field_T(FAR_M), 2e-3)
    fine = -np.array([at_front, 1.0 - at_front]) @ np.array(
        [np.linspace(0, n_missing, 2001), 6 - np.linspace(0, n_missing, 2001)]
    )
    middle_m = PITCH_M * 0.5 * (fine[1:] + fine[:-1])
    smeared = Loops(np.full(2000, 0.0395), middle_m, np.full(2000, -n_missing / 2000))
    assert_same_field(added_T(ONE, effect), smeared.field_T(POINTS_M), 1e-5)


@pytest.mark.parametrize("axis", ["cos2", "sin2"])
def test_coil_ovality_is_the_slope_of_wires_bent_to_r_a_1_plus_e_cos_2_phi(axis):
    """The code takes the first order in e, on fewer loops than there are."""
    phi = np.linspace(0.0, 2.0 * np.pi, 721)
    wave = np.cos(2.0 * phi) if axis == "cos2" else np.sin(2.0 * phi)
    loops = winding()

    def oval_T(e: float) -> np.ndarray:
        total = np.zeros_like(FAR_M)
        for a, z in zip(loops.radius_m, loops.height_m, strict=True):
            r = a * (1.0 + e * wave)
            vertices_m = np.stack((r * np.cos(phi), r * np.sin(phi), np.full_like(phi, z)), axis=1)
            total += polyline_T(vertices_m, FAR_M)
        return total

    e = 0.01
    slope = (oval_T(e) - oval_T(-e)) / 2.0
    assert_same_field(added_T(ONE_FAR, {"coil_ovality[coil]": {axis: e}}), slope, 1e-3)


def test_oval_coil_is_summed_for_some_points_at_a_time(monkeypatch):
    oval = {"coil_ovality[coil]": {"cos2": 0.01, "sin2": 0.02}}
    together_T = added_T(ONE_FAR, oval)
    monkeypatch.setattr(causes_of_coil, "POINTS_AT_ONCE", 3)
    assert_same_field(added_T(ONE_FAR, oval), together_T, 1e-9)


def test_oval_coil_is_longer_along_x_where_its_cosine_part_is_positive():
    near_m = np.array([[0.05, 0.0, -0.003], [0.0, 0.05, -0.003]])
    added = added_T(readings(near_m, (1.0, 0.0)), {"coil_ovality[coil]": {"cos2": 0.01}})[:, 2]
    assert added[0] < 0.0 < added[1]  # beside the coil the field points down, and the wire comes nearer on x


def test_sheared_winding_is_a_sum_of_loops_whose_centres_follow_a_leaning_line():
    shear = np.array([0.3, -0.1, 0.0])
    loops, total = winding(), np.zeros_like(POINTS_M)
    for a, z in zip(loops.radius_m, loops.height_m, strict=True):
        centre_m = shear * (z + 0.5 * LENGTH_M)
        total += Loops(np.array([a]), np.array([z]), np.ones(1)).field_T(POINTS_M - centre_m)
    reading_T = predicted_T(ONE, {"winding_sheared[coil]": {"shear_x": 0.3, "shear_y": -0.1}})
    assert_same_field(reading_T, total)
    assert (
        np.linalg.norm(total - loops.field_T(POINTS_M), axis=1) > 1e-4 * np.linalg.norm(total, axis=1)
    ).all()


@pytest.mark.parametrize("azimuth", [0.0, 2.2])
def test_lead_wire_is_a_rectangle_whose_current_leaves_on_the_front_side(azimuth):
    gap_m, length_m = 0.012, 0.25
    outward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    front, back = (up * (-0.5 * LENGTH_M + side * 0.5 * gap_m) for side in (1.0, -1.0))
    near, far = 0.04 * outward, (0.04 + length_m) * outward
    vertices_m = np.array([near + front, far + front, far + back, near + back, near + front])
    given = {"gap_m": gap_m, "azimuth_rad": azimuth, "length_m": length_m}
    assert_same_field(added_T(ONE, {"lead_wire[coil]": given}), polyline_T(vertices_m, POINTS_M), 1e-9)


def test_leads_without_a_gap_make_no_field():
    given = {"gap_m": 0.0, "azimuth_rad": 0.5, "length_m": 0.3}
    assert np.abs(added_T(ONE, {"lead_wire[coil]": given})).max() < 1e-18


def rod_T(share: float, points_m: np.ndarray) -> np.ndarray:
    """A thin magnet as long as the winding by magpylib, with a share of the winding's moment."""
    diameter_m = 1e-4
    volume_m3 = 0.25 * np.pi * diameter_m**2 * LENGTH_M
    polarization_T = magpylib.mu_0 * share * winding().moment_m2 / volume_m3
    magnet = magpylib.magnet.Cylinder(
        dimension=(diameter_m, LENGTH_M),
        polarization=(0.0, 0.0, polarization_T),
        position=(0, 0, -LENGTH_M / 2),
    )
    return MU0_RATIO * magnet.getB(points_m)


def test_iron_core_is_a_thin_magnet_in_the_bore_with_a_share_of_the_moment():
    outside_m = np.delete(POINTS_M, 5, axis=0)  # the magnet's cells need distance
    difference_T = added_T(readings(outside_m, (2.0, 0.0)), {"iron_core[coil]": {"share": 0.3}})
    assert_same_field(difference_T, 2.0 * rod_T(0.3, outside_m), 1e-4)


def test_iron_core_is_a_dipole_of_its_share_of_the_moment_far_away():
    far_m = 1.0 * np.array([[0.3, 0.4, 0.866], [-0.9, 0.1, 0.4]])
    moment = np.array([0.0, 0.0, 0.3 * winding().moment_m2])
    difference_T = added_T(readings(far_m, (1.0, 0.0)), {"iron_core[coil]": {"share": 0.3}})
    assert_same_field(difference_T, dipole_T(moment, np.array([0, 0, -LENGTH_M / 2]), far_m), 1e-4)


def test_saturating_core_is_a_plain_core_at_small_currents():
    small = readings(POINTS_M, (1e-3, 0.0))
    saturating = added_T(small, {"core_saturation[coil]": {"share": 0.3, "loss_per_A2": 0.02}})
    assert_same_field(saturating, added_T(small, {"iron_core[coil]": {"share": 0.3}}), 1e-6)


def test_saturating_core_loses_a_cubic_in_the_current_and_is_odd_in_it():
    def core_T(current_A: float) -> np.ndarray:
        given = {"share": 0.3, "loss_per_A2": 0.02}
        return added_T(readings(POINTS_M, (current_A, 0.0)), {"core_saturation[coil]": given})

    core_per_A = added_T(ONE, {"iron_core[coil]": {"share": 1.0}})
    for current_A in (0.5, 1.0, 3.0):
        assert_same_field(core_T(current_A), (0.3 * current_A - 0.02 * current_A**3) * core_per_A)
        assert_same_field(core_T(-current_A), -core_T(current_A), 1e-12)


def test_spherical_sum_is_the_papers_sum_taken_literally():
    """Spherical components of every loop about its own centre, added along the axes of the middle of the front face (eq 13)."""
    loops = winding()
    rho = np.hypot(POINTS_M[:, 0], POINTS_M[:, 1])
    east = np.divide(POINTS_M[:, :2], rho[:, None], out=np.zeros((len(rho), 2)), where=rho[:, None] > 0.0)
    b_r, b_theta = np.zeros(len(rho)), np.zeros(len(rho))
    for a, z in zip(loops.radius_m, loops.height_m, strict=True):
        b = Loops(np.array([a]), np.array([z]), np.ones(1)).field_T(POINTS_M)
        b_rho, theta = (b[:, :2] * east).sum(1), np.arctan2(rho, POINTS_M[:, 2] - z)
        b_r += b_rho * np.sin(theta) + b[:, 2] * np.cos(theta)
        b_theta += b_rho * np.cos(theta) - b[:, 2] * np.sin(theta)
    theta = np.arctan2(rho, POINTS_M[:, 2])
    b_rho = b_r * np.sin(theta) + b_theta * np.cos(theta)
    b_z = b_r * np.cos(theta) - b_theta * np.sin(theta)
    literal = np.stack((b_rho * east[:, 0], b_rho * east[:, 1], b_z), axis=1)
    reading_T = predicted_T(ONE, {"spherical_sum[coil]": {"weight": 1.0}})
    assert_same_field(reading_T, literal, 1e-8)
    right = winding().field_T(POINTS_M)
    assert (np.linalg.norm(literal - right, axis=1) > 1e-3 * np.linalg.norm(right, axis=1)).any()
    half = predicted_T(ONE, {"spherical_sum[coil]": {"weight": 0.5}})
    assert_same_field(half, 0.5 * (literal + right), 1e-8)
    printed = RIG.replace("{radius_mm: 40,", "{field_sum: spherical_components, radius_mm: 40,")
    assert_same_field(predicted_T(ONE, rig=printed), literal, 1e-8)
    assert_same_field(predicted_T(ONE, {"spherical_sum[coil]": {"weight": -1.0}}, printed), right, 1e-8)


def test_dipole_model_is_mu0_m_over_4_pi_r3_about_the_middle_of_the_winding():
    moment_m2, middle_m = winding().moment_m2, np.array([0.0, 0.0, -LENGTH_M / 2])
    r_m = 0.09
    axis_and_equator_m = middle_m + r_m * np.array([[0.0, 0.0, 1.0], [0.6, -0.8, 0.0]])
    reading_T = predicted_T(readings(axis_and_equator_m, (1.0, 0.0)), {"dipole_model[coil]": {"weight": 1.0}})
    unit_T = MU0_RATIO * magpylib.mu_0 * moment_m2 / (4.0 * np.pi * r_m**3)
    np.testing.assert_allclose(
        reading_T, unit_T * np.array([[0, 0, 2.0], [0, 0, -1.0]]), rtol=1e-9, atol=1e-18
    )
    everywhere = predicted_T(ONE, {"dipole_model[coil]": {"weight": 1.0}})
    assert_same_field(everywhere, dipole_T(np.array([0.0, 0.0, moment_m2]), middle_m, POINTS_M))
