"""One loop against sixty digits of the textbook formula, from the wire itself out to a hundred thousand radii."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch
from mpmath import mpf
from torch import Tensor
from torch.func import hessian, jacfwd, jacrev

from estimator.field.loop import (
    MOST_STEPS,
    agm_steps,
    loop_derivatives,
    loop_field,
    loop_terms,
    steps_for_ratio,
)
from estimator.units import MU0_T_M_PER_A

RADIUS_M = 0.05
# Worst errors measured: 5.2e-15 in double and 2.4e-6 in single precision, both next to the wire.
BOUND = {torch.float64: 1e-13, torch.float32: 1e-5}
DTYPES = (torch.float64, torch.float32)


def textbook(point_m: list[float], radius_m: float) -> list[mpf]:
    """B per ampere by complete elliptic integrals (eq 4 of the paper; Simpson et al., NASA 2001), to 60 digits."""
    with mpmath.workdps(60):
        x, y, z, a, mu0 = (mpf(v) for v in (*point_m, radius_m, MU0_T_M_PER_A))
        rho = mpmath.sqrt(x**2 + y**2)
        if rho == 0:
            return [mpf(0), mpf(0), mu0 * a**2 / (2 * mpmath.sqrt(a**2 + z**2) ** 3)]
        alpha2, beta2 = (a - rho) ** 2 + z**2, (a + rho) ** 2 + z**2
        m = 1 - alpha2 / beta2
        K, E = mpmath.ellipk(m), mpmath.ellipe(m)
        scale = mu0 / (2 * mpmath.pi * mpmath.sqrt(beta2))
        Bz = scale * (K + (a**2 - rho**2 - z**2) / alpha2 * E)
        B_rho = scale * z / rho * (-K + (a**2 + rho**2 + z**2) / alpha2 * E)
        return [B_rho * x / rho, B_rho * y / rho, Bz]


def textbook_derivatives(point_m: list[float], radius_m: float) -> list[float]:
    """dB/dz per ampere: a difference of which 20 digits are left."""
    x, y, z = point_m
    step = mpf("1e-20")
    with mpmath.workdps(60):
        up, down = (textbook([x, y, mpf(z) + shift], radius_m) for shift in (step, -step))
        return [float((a - b) / (2 * step)) for a, b in zip(up, down, strict=True)]


def relative_errors(points_m: Tensor, radius_m: float = RADIUS_M) -> np.ndarray:
    """|B - textbook| / |textbook| for each point, the points taken as the number format holds them."""
    radius = torch.tensor(radius_m, dtype=points_m.dtype)
    field_T = loop_field(points_m, radius)
    errors = []
    for point, ours in zip(points_m.tolist(), field_T.tolist(), strict=True):
        exact = textbook(point, radius.item())
        difference = mpmath.norm([mpf(o) - e for o, e in zip(ours, exact, strict=True)])
        errors.append(float(difference / mpmath.norm(exact)))
    return np.array(errors)


def directions(number: int, seed: int) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(number, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("dtype", DTYPES)
def test_field_on_the_axis_is_exact_to_rounding(dtype):
    heights = torch.tensor([0.0, 1e-9, 1e-3, -0.02, 0.3, 5.0, -5000.0], dtype=dtype)
    points_m = torch.stack((0 * heights, 0 * heights, heights), -1)
    assert relative_errors(points_m).max() < BOUND[dtype]


@pytest.mark.parametrize("dtype", DTYPES)
def test_field_next_to_the_axis_is_exact_to_rounding_although_the_textbook_cancels_there(dtype):
    heights = torch.tensor([0.0, 1e-9, 1e-3, -0.02, 0.3, 5.0], dtype=dtype)
    for off_axis_m in (1e-15, 1e-12, 1e-8, 1e-5):
        points_m = torch.stack((0 * heights + off_axis_m, 0 * heights - 2 * off_axis_m, heights), -1)
        assert relative_errors(points_m).max() < BOUND[dtype]


def test_radial_component_next_to_the_axis_keeps_its_own_digits():
    """The radial part is 1e-11 of |B| here, so that an error in it would not show in the vector's."""
    point = [1e-12, 0.0, 0.03]
    ours = loop_field(torch.tensor(point, dtype=torch.float64), torch.tensor(RADIUS_M, dtype=torch.float64))
    assert ours[0].item() == pytest.approx(float(textbook(point, RADIUS_M)[0]), rel=1e-14)


@pytest.mark.parametrize("dtype", DTYPES)
def test_field_at_generic_points_is_exact_to_rounding(dtype):
    points_m = np.random.default_rng(1).normal(size=(150, 3)) * RADIUS_M
    assert relative_errors(torch.tensor(points_m, dtype=dtype)).max() < BOUND[dtype]


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("decade", range(1, 10))
def test_field_near_the_wire_is_exact_to_rounding(decade, dtype):
    """In the plane y = 0, where the number format can hold a point so close to the wire."""
    angles = np.random.default_rng(decade).uniform(0, 2 * math.pi, 20)
    distance_m = RADIUS_M * 10.0**-decade
    rho_m, z_m = RADIUS_M + distance_m * np.cos(angles), distance_m * np.sin(angles)
    for side in (1, -1):
        points_m = torch.tensor(np.stack((side * rho_m, 0 * rho_m, z_m), -1), dtype=dtype)
        assert relative_errors(points_m).max() < BOUND[dtype]


@pytest.mark.parametrize("dtype", DTYPES)
def test_field_near_the_wire_at_any_azimuth_is_as_exact_as_the_coordinates(dtype):
    """Coordinates carry eps a, which changes a field that goes as 1 / distance by eps a / distance; we add no more than that."""
    random = np.random.default_rng(2)
    for distance in 10.0 ** -np.arange(1.0, 7.0):
        theta, phi = random.uniform(0, 2 * math.pi, (2, 20))
        rho_m, z_m = RADIUS_M * (1 + distance * np.cos(theta)), RADIUS_M * distance * np.sin(theta)
        points_m = torch.tensor(np.stack((rho_m * np.cos(phi), rho_m * np.sin(phi), z_m), -1), dtype=dtype)
        double_m = points_m.double().numpy()
        to_wire = np.hypot(np.hypot(double_m[:, 0], double_m[:, 1]) - RADIUS_M, double_m[:, 2]) / RADIUS_M
        assert (relative_errors(points_m) < 2.0 * torch.finfo(dtype).eps * (1.0 + 1.0 / to_wire)).all()


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("radii", [1e1, 1e2, 1e3, 1e4, 1e5])
def test_field_far_away_is_exact_to_rounding(radii, dtype):
    points_m = torch.tensor(directions(30, seed=3) * RADIUS_M * radii, dtype=dtype)
    assert relative_errors(points_m).max() < BOUND[dtype]


def test_first_derivative_on_the_axis_is_the_analytic_one():
    radius = torch.tensor(RADIUS_M, dtype=torch.float64)
    for z in (0.0, 0.013, -0.07, 2.0):
        dBz_dz = -1.5 * MU0_T_M_PER_A * RADIUS_M**2 * z / (RADIUS_M**2 + z**2) ** 2.5
        expected = torch.diag(torch.tensor([-0.5, -0.5, 1.0], dtype=torch.float64)) * dBz_dz
        point = torch.tensor([0.0, 0.0, z], dtype=torch.float64)
        for differentiate in (jacfwd, jacrev):
            jacobian = differentiate(loop_field)(point, radius)
            torch.testing.assert_close(jacobian, expected, rtol=1e-13, atol=1e-20)


def test_second_derivative_on_the_axis_is_the_analytic_one():
    """Of a divergence-free, curl-free field symmetric about z: all second derivatives follow from d2Bz/dz2."""
    radius = torch.tensor(RADIUS_M, dtype=torch.float64)
    for z in (0.0, 0.013, -0.07):
        s2 = RADIUS_M**2 + z**2
        d2 = MU0_T_M_PER_A * RADIUS_M**2 * (6.0 * z**2 - 1.5 * RADIUS_M**2) / s2**3.5
        expected = torch.zeros(3, 3, 3, dtype=torch.float64)
        expected[2, 2, 2] = d2
        for i in (0, 1):
            expected[2, i, i] = expected[i, i, 2] = expected[i, 2, i] = -0.5 * d2
        second = hessian(loop_field)(torch.tensor([0.0, 0.0, z], dtype=torch.float64), radius)
        torch.testing.assert_close(second, expected, rtol=1e-12, atol=1e-12 * abs(d2))


def test_derivative_in_the_radius_is_the_analytic_one_on_the_axis():
    for z in (0.0, 0.03):
        point = torch.tensor([0.0, 0.0, z], dtype=torch.float64)
        derivative = jacfwd(loop_field, argnums=1)(point, torch.tensor(RADIUS_M, dtype=torch.float64))
        s2 = RADIUS_M**2 + z**2
        expected = 0.5 * MU0_T_M_PER_A * RADIUS_M * (2.0 * z**2 - RADIUS_M**2) / s2**2.5
        assert derivative[2].item() == pytest.approx(expected, rel=1e-13)


def points_at_ratio(ratio: float) -> tuple[Tensor, Tensor, Tensor]:
    """Points whose nearest over farthest distance to the wire is `ratio`, all around the wire."""
    angles = torch.linspace(0.0, math.pi, 7, dtype=torch.float64)
    rho = RADIUS_M * (1.0 + 2.0 * ratio * torch.cos(angles))
    z = RADIUS_M * 2.0 * ratio * torch.sin(angles)
    return rho, torch.zeros_like(rho), z


@pytest.mark.parametrize("scale", [1e-6, 1e-2, 1.0, 1e2], ids="{:g} radii from the centre".format)
def test_derivatives_along_the_axis_agree_with_sixty_digits(scale):
    points_m = torch.from_numpy(scale * RADIUS_M * directions(6, seed=7))
    x, y, z = points_m.unbind(-1)
    radius = torch.tensor(RADIUS_M, dtype=torch.float64)
    derivatives = loop_derivatives(x, y, z, radius, MOST_STEPS)
    torch.testing.assert_close(
        torch.stack(derivatives[:2]), torch.stack(loop_terms(x, y, z, radius, MOST_STEPS))
    )
    for i, point in enumerate(points_m.tolist()):
        radial, _, axial = textbook_derivatives(point, RADIUS_M)
        size = float(mpmath.norm(textbook(point, RADIUS_M))) / max(RADIUS_M, RADIUS_M * scale)
        assert point[0] * derivatives.h_z_T_per_A_m2[i].item() == pytest.approx(radial, abs=1e-13 * size)
        assert derivatives.axial_z_T_per_A_m[i].item() == pytest.approx(axial, abs=1e-13 * size)


@pytest.mark.parametrize("ratio", [0.4, 0.3, 0.1, 1e-2, 1e-3, 1e-4, 1e-6, 1e-8])
def test_more_agm_steps_than_chosen_change_nothing_and_fewer_do(ratio):
    x, y, z = points_at_ratio(ratio)
    radius = torch.tensor(RADIUS_M, dtype=torch.float64)
    steps = agm_steps(x, y, z, radius)

    def field(n: int) -> Tensor:
        h, axial = loop_terms(x, y, z, radius, n)
        return torch.stack((x * h, axial))

    most = field(MOST_STEPS)
    norm = most.norm(dim=0)
    assert ((field(steps) - most).norm(dim=0) <= 4e-15 * norm).all()
    assert ((field(steps - 3) - most).norm(dim=0) > 1e-12 * norm).any()


def test_nearest_point_decides_the_steps_and_none_of_them_is_too_many():
    near, far = torch.tensor(1e-6, dtype=torch.float64), torch.tensor(1.0, dtype=torch.float64)
    radius, zero = torch.tensor(RADIUS_M, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    x = RADIUS_M + torch.stack((far, near))
    assert agm_steps(x, zero, zero, radius) == agm_steps(x[1:], zero[1:], zero[1:], radius)
    assert agm_steps(x, zero, zero, radius) > agm_steps(x[:1], zero[:1], zero[:1], radius)
    assert agm_steps(zero[:0], zero[:0], zero[:0], radius) == agm_steps(zero, zero, zero, radius)
    steps = [steps_for_ratio(ratio) for ratio in (1.0, 0.5, 1e-2, 1e-5, 1e-12, 1e-100)]
    assert steps == sorted(steps)
    assert steps_for_ratio(0.0) == MOST_STEPS


def test_points_and_radii_broadcast_like_a_loop_over_them():
    random = np.random.default_rng(4)
    points_m = torch.tensor(random.normal(size=(4, 1, 5, 3)) * 0.1)
    radii_m = torch.tensor(random.uniform(0.02, 0.06, size=(3, 1)))
    together = loop_field(points_m, radii_m, current_A=-2.5)
    assert together.shape == (4, 3, 5, 3)
    for i, j, k in np.ndindex(4, 3, 5):
        alone = loop_field(points_m[i, 0, k], radii_m[j, 0], current_A=-2.5)
        torch.testing.assert_close(together[i, j, k], alone, rtol=1e-14, atol=0.0)


@pytest.mark.parametrize("dtype", DTYPES)
def test_number_format_is_kept(dtype):
    assert loop_field(torch.ones(2, 3, dtype=dtype), torch.tensor(0.05, dtype=dtype)).dtype == dtype
