"""Laws that the field of any coils must obey, whatever formula computes it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.field.winding import Winding
from estimator.model.room_field import RoomField
from estimator.rig.coordinates import Values
from estimator.rig_files.read import rig_from_text
from estimator.units import MU0_T_M_PER_A
from tests.by_zones import winding_field

TWO_COILS = """
schema_version: 1
name: two coils in the room
coils:
  coil1: {radius_mm: 51, wire_radius_mm: 0.49, axial_loops: 48, radial_loops: 25,
          world_from_coil: {x_mm: -20, y_mm: 10, z_mm: -60, rx_deg: 20, ry_deg: -35, spin_deg: 70}}
  coil2: {radius_mm: 40, axial_pitch_mm: 1.74, radial_pitch_mm: 1.06, axial_loops: 12, radial_loops: 9, current_gain: 1.01,
          world_from_coil: {x_mm: 70, y_mm: -30, z_mm: 90, rx_deg: 150, tilt_y_deg: 12}}
sensors: {hall: {noise_uT: 20}}
"""
CURRENT_A = torch.tensor([2.0, -3.5], dtype=torch.float64)


def tensor(value: object) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def winding(
    radius_m: float, axial: float, radial: float, axial_pitch_m: float, radial_pitch_m: float
) -> Winding:
    return Winding(*map(tensor, (radius_m, axial, radial, axial_pitch_m, radial_pitch_m)))


TABLE_TOP = winding(0.051, 48.0, 25.0, 0.98e-3, 0.98e-3)


def loop_radii_and_heights(coil: Winding) -> tuple[Tensor, Tensor]:
    heights_m = -coil.axial_pitch_m * (torch.arange(int(coil.axial_loops)).double() + 0.5)
    radii_m = coil.radius_m - coil.radial_pitch_m * (torch.arange(int(coil.radial_loops)).double() + 0.5)
    return radii_m, heights_m


def gauss_legendre(lower: float, upper: float, n: int) -> tuple[Tensor, Tensor]:
    nodes, weights = np.polynomial.legendre.leggauss(n)
    half = 0.5 * (upper - lower)
    return tensor(lower + half * (nodes + 1.0)), tensor(half * weights)


@pytest.fixture(scope="module")
def room() -> tuple[RoomField, Values]:
    rig = rig_from_text(TWO_COILS)
    values = {name: tensor(value) for name, value in rig.nominal_values().items()}
    points_m = tensor(np.random.default_rng(0).uniform(-0.15, 0.15, size=(80, 3)))
    return RoomField(rig, values, points_m), values


def test_divergence_and_curl_vanish_in_free_space(room):
    field, values = room
    gradient = field.gradient_T_per_m(values, CURRENT_A)[~field.is_inside]
    norm = gradient.flatten(1).norm(dim=1)
    assert len(gradient) > 60
    assert (gradient.diagonal(dim1=1, dim2=2).sum(1).abs() < 1e-12 * norm).all()
    assert ((gradient - gradient.mT).flatten(1).norm(dim=1) < 1e-12 * norm).all()
    assert (gradient.diagonal(dim1=1, dim2=2).abs().sum(1) > 1e-3 * norm).all()


def test_currents_superpose_and_reverse(room):
    field, values = room
    free = ~field.is_inside
    first, second = torch.diag(CURRENT_A)
    both = field.field_T(values, CURRENT_A)[free]
    apart = field.field_T(values, first)[free] + field.field_T(values, second)[free]
    torch.testing.assert_close(both, apart, rtol=1e-12, atol=1e-18)
    torch.testing.assert_close(field.field_T(values, -CURRENT_A)[free], -both, rtol=1e-13, atol=1e-18)
    torch.testing.assert_close(
        field.field_T(values, 3.0 * CURRENT_A)[free], 3.0 * both, rtol=1e-13, atol=1e-18
    )


def test_field_is_that_of_biot_and_savart():
    """Their integral over straight pieces of every loop; over a closed smooth curve the sum converges exponentially."""
    coil = winding(0.05, 3.0, 2.0, 4e-3, 3e-3)
    points_m = tensor([[0.0, 0.0, 0.02], [0.03, -0.02, 0.015], [0.08, 0.01, -0.005], [-0.01, 0.02, -0.006]])
    angle = torch.arange(720).double() * (2.0 * torch.pi / 720)
    expected = torch.zeros_like(points_m)
    radii_m, heights_m = loop_radii_and_heights(coil)
    for a in radii_m:
        for z in heights_m:
            wire = torch.stack((a * angle.cos(), a * angle.sin(), z.expand(720)), -1)
            along = torch.stack((-a * angle.sin(), a * angle.cos(), 0 * angle), -1) * (2.0 * torch.pi / 720)
            away = points_m[:, None, :] - wire
            pieces = torch.linalg.cross(along.expand_as(away), away) / away.norm(dim=-1, keepdim=True) ** 3
            expected += MU0_T_M_PER_A / (4.0 * torch.pi) * pieces.sum(1)
    torch.testing.assert_close(winding_field(points_m, coil, 0.0), expected, rtol=1e-11, atol=1e-18)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-3])
def test_ampere_line_integral_around_the_winding_is_mu0_times_the_current_through_it(tolerance):
    """The current runs counter-clockwise seen from +z, so the path runs up the bore, outwards in front, and down outside."""
    inner, outer, front, back = 0.016, 0.062, 0.01, -0.0572
    rho, w_rho = gauss_legendre(inner, outer, 60)
    z, w_z = gauss_legendre(back, front, 60)

    def along(rho_m: Tensor, z_m: Tensor, component: int) -> Tensor:
        points_m = torch.stack((0.6 * rho_m, 0.8 * rho_m, z_m), -1)
        field = winding_field(points_m, TABLE_TOP, tolerance)
        return field[:, 2] if component == 2 else 0.6 * field[:, 0] + 0.8 * field[:, 1]

    def full(value: float, like: Tensor) -> Tensor:
        return torch.full_like(like, value)

    up = (w_z * along(full(inner, z), z, 2)).sum()
    out = (w_rho * along(rho, full(front, rho), 0)).sum()
    down = -(w_z * along(full(outer, z), z, 2)).sum()
    back_in = -(w_rho * along(rho, full(back, rho), 0)).sum()
    assert (up + out + down + back_in).item() == pytest.approx(MU0_T_M_PER_A * 48 * 25, rel=tolerance)


def test_ampere_line_integral_that_encloses_no_winding_vanishes():
    rho, w_rho = gauss_legendre(0.0, 0.016, 30)
    z, w_z = gauss_legendre(-0.05, 0.02, 60)

    def points(rho_m: Tensor, z_m: Tensor) -> Tensor:
        return torch.stack(torch.broadcast_tensors(rho_m, 0.0 * rho_m, z_m), -1)

    up = (w_z * winding_field(points(0.0 * z, z), TABLE_TOP)[:, 2]).sum()
    out = (w_rho * winding_field(points(rho, 0.0 * rho + 0.02), TABLE_TOP)[:, 0]).sum()
    down = (w_z * winding_field(points(0.0 * z + 0.016, z), TABLE_TOP)[:, 2]).sum()
    back_in = (w_rho * winding_field(points(rho, 0.0 * rho - 0.05), TABLE_TOP)[:, 0]).sum()
    assert abs((up + out - down - back_in).item()) < 1e-6 * up.item()
    assert abs((up - down).item()) > 1e-2 * up.item()


def test_no_flux_leaves_a_closed_surface_around_the_coil():
    cosine, weight = gauss_legendre(-1.0, 1.0, 40)
    azimuth = torch.arange(40).double() * (2.0 * torch.pi / 40)
    sine = (1.0 - cosine**2).sqrt()
    normal = torch.stack(
        torch.broadcast_tensors(
            sine[:, None] * azimuth.cos(), sine[:, None] * azimuth.sin(), cosine[:, None]
        ),
        -1,
    ).reshape(-1, 3)
    centre_m = tensor([0.01, -0.02, -0.03])
    through = (winding_field(centre_m + 0.12 * normal, TABLE_TOP, 0.0) * normal).sum(-1)
    flux = (weight[:, None] * through.reshape(40, 40)).sum()
    assert abs(flux.item()) < 1e-12 * (weight[:, None] * through.abs().reshape(40, 40)).sum().item()


def test_far_away_the_field_is_that_of_a_dipole_with_the_moment_of_all_loops():
    radii_m, heights_m = loop_radii_and_heights(TABLE_TOP)
    moment = torch.pi * (radii_m**2).sum() * len(heights_m) * tensor([0.0, 0.0, 1.0])
    centre_m = torch.stack((0 * heights_m.mean(), 0 * heights_m.mean(), heights_m.mean()))
    direction = tensor(np.random.default_rng(1).normal(size=(20, 3)))
    direction = direction / direction.norm(dim=1, keepdim=True)
    dipole = MU0_T_M_PER_A / (4.0 * torch.pi) * (3.0 * (direction @ moment)[:, None] * direction - moment)

    def error(distance_m: float) -> Tensor:
        field = winding_field(centre_m + distance_m * direction, TABLE_TOP, 1e-9) * distance_m**3
        return (field - dipole).norm(dim=1) / dipole.norm(dim=1)

    assert error(50.0).max() < 3e-6
    assert (error(5.0) / error(10.0)).median().item() == pytest.approx(4.0, rel=0.01)  # next comes 1 / r^2


@pytest.mark.parametrize("scale", [0.01, 3.0, 40.0])
def test_all_lengths_times_k_give_the_field_over_k(scale):
    points_m = tensor(np.random.default_rng(2).uniform(0.06, 0.12, size=(20, 3)))
    scaled = winding(0.051 * scale, 48.0, 25.0, 0.98e-3 * scale, 0.98e-3 * scale)
    field = winding_field(scale * points_m, scaled, 0.0)
    torch.testing.assert_close(field, winding_field(points_m, TABLE_TOP, 0.0) / scale, rtol=1e-12, atol=0.0)


def test_field_is_symmetric_about_the_axis_and_about_the_middle_plane():
    random = np.random.default_rng(3)
    rho_m = tensor(random.uniform(0.0, 0.02, 20))
    height_m = tensor(random.uniform(0.0, 0.1, 20))
    middle_m = -0.5 * float(TABLE_TOP.length_m)

    def cylindrical(azimuth: float, above_m: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        c, s = np.cos(azimuth), np.sin(azimuth)
        field = winding_field(torch.stack((c * rho_m, s * rho_m, middle_m + above_m), -1), TABLE_TOP, 0.0)
        return c * field[:, 0] + s * field[:, 1], c * field[:, 1] - s * field[:, 0], field[:, 2]

    radial, around, axial = cylindrical(0.0, height_m)
    assert (around == 0.0).all()
    for azimuth in (0.7, 2.9, -1.6):
        turned = cylindrical(azimuth, height_m)
        torch.testing.assert_close(turned, (radial, around, axial), rtol=1e-12, atol=1e-18)
    mirrored = cylindrical(0.0, -height_m)
    torch.testing.assert_close(mirrored, (-radial, around, axial), rtol=1e-12, atol=1e-18)


def test_coil_turned_over_in_place_is_the_coil_with_its_current_reversed():
    text = """
schema_version: 1
name: turned over
coils:
  coil1: {radius_mm: 51, wire_radius_mm: 0.49, axial_loops: 48, radial_loops: 25, world_from_coil: {x_mm: 5, z_mm: 23.52}}
  coil2: {radius_mm: 51, wire_radius_mm: 0.49, axial_loops: 48, radial_loops: 25, world_from_coil: {x_mm: 5, z_mm: -23.52, rx_deg: 180}}
sensors: {hall: {noise_uT: 20}}
"""
    rig = rig_from_text(text)
    values = {name: tensor(value) for name, value in rig.nominal_values().items()}
    points_m = tensor([[0.0, 0.0, 0.05], [0.09, 0.02, 0.01], [0.01, 0.0, -0.02]])
    field = RoomField(rig, values, points_m, tolerance=1e-12)
    upright_T, turned_T = (field.field_T(values, current) for current in torch.eye(2).double())
    torch.testing.assert_close(turned_T, -upright_T, rtol=1e-10, atol=1e-16)


def test_middle_of_a_long_solenoid_holds_mu0_n_i_and_none_of_it_gets_out():
    def solenoid(loops: int) -> Winding:
        return winding(0.01, float(loops), 1.0, 1e-3, 1e-5)

    n_per_m = 1000.0
    for loops in (400, 800):
        middle_m = -0.5e-3 * loops
        points_m = tensor([[0.0, 0.0, middle_m], [0.006, 0.002, middle_m], [0.02, 0.0, middle_m]])
        field = winding_field(points_m, solenoid(loops), 1e-9)[:, 2] / (MU0_T_M_PER_A * n_per_m)
        missing = 2.0 * (0.01 / (1e-3 * loops)) ** 2  # 1 - L / sqrt(L^2 + 4 a^2), to first order
        assert (1.0 - field[:2]).tolist() == pytest.approx([missing, missing], rel=0.02)
        assert abs(field[2].item()) < 2.0 * missing


def test_helmholtz_pair_has_its_known_field_and_no_first_three_derivatives():
    radius_m, turns = 0.15, 100.0

    def axial(z: Tensor) -> Tensor:
        coil = winding(radius_m + 1e-9, 1.0, 1.0, 2e-9, 2e-9)
        points = torch.stack((0 * z, 0 * z, z))
        both = (points + tensor([0.0, 0.0, s * 0.5 * radius_m]) for s in (-1.0, 1.0))
        return turns * sum(winding_field(p[None], coil, 0.0)[0, 2] for p in both)

    zero = tensor(0.0)
    derivatives = [axial]
    for _ in range(3):
        derivatives.append(torch.func.jacfwd(derivatives[-1]))
    field = axial(zero).item()
    assert field == pytest.approx(0.8**1.5 * MU0_T_M_PER_A * turns / radius_m, rel=1e-7)
    for order in (1, 2, 3):
        assert abs(derivatives[order](zero).item()) * radius_m**order < 1e-6 * field
