"""Windings with straight sides: closed formulas, a second library, round windings, field laws, derivatives and quadrature."""

from __future__ import annotations

import math

import magpylib
import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.derivatives import jacobian_of
from estimator.field.node_sum import SumMode
from estimator.field.sided import SidedWinding, distance_to_sided, full_sided_rule, sided_field_per_ampere
from estimator.field.straight import MU0_OVER_4PI
from estimator.field.winding import Winding, exact_rule, winding_field_per_ampere
from estimator.field.winding_shape import Rule, choose_rule
from estimator.units import MU0_T_M_PER_A

MAGPYLIB_OVER_OURS = 4e-7 * np.pi / MU0_T_M_PER_A  # it keeps the mu0 of before 2019


def tensor(value: object) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def sided(*numbers: float, is_rounded: bool = False) -> SidedWinding:
    return SidedWinding(is_rounded, *map(tensor, numbers))


RECTANGULAR = sided(0.06, 0.04, 0.0, 4.0, 3.0, 1e-3, 1.2e-3)
RACETRACK = sided(0.06, 0.04, 0.008, 4.0, 3.0, 1e-3, 1.2e-3, is_rounded=True)
BOTH = pytest.mark.parametrize("winding", [RECTANGULAR, RACETRACK], ids=["rectangular", "racetrack"])


def points_about(winding: SidedWinding, nearest_m: float, number: int = 300, seed: int = 0) -> Tensor:
    points_m = tensor(np.random.default_rng(seed).uniform(-0.09, 0.09, (number, 3)))
    return points_m[distance_to_sided(points_m, winding) > nearest_m]


def of_all_loops(points_m: Tensor, winding: SidedWinding) -> Tensor:
    return sided_field_per_ampere(points_m, winding, full_sided_rule(winding, points_m))


def relative_error(found: Tensor, expected: Tensor) -> float:
    return float(((found - expected).norm(dim=-1) / expected.norm(dim=-1)).max())


def outline(half_x_m: float, half_y_m: float, radius_m: float, per_arc: int) -> np.ndarray:
    """Corners of one loop, counter-clockwise; arcs as chords whose ends lie on them."""
    corners = []
    for quarter, (right, back) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        angle = 0.5 * np.pi * (quarter + np.linspace(0.0, 1.0, per_arc))
        x = right * (half_x_m - radius_m) + radius_m * np.cos(angle)
        y = back * (half_y_m - radius_m) + radius_m * np.sin(angle)
        corners += list(zip(x, y, strict=True))
    return np.array([*corners, corners[0]])


def loops_by_magpylib(winding: SidedWinding, per_arc: int) -> magpylib.Collection:
    side_x, side_y, corner, axial, radial, axial_pitch, radial_pitch = (float(n) for n in winding.numbers)
    loops = magpylib.Collection()
    for row in range(int(axial)):
        for layer in range(int(radial)):
            out = radial_pitch * (layer + 0.5)
            radius = corner + out if winding.is_rounded else 0.0
            flat = outline(0.5 * side_x + out, 0.5 * side_y + out, radius, per_arc)
            height = np.full((len(flat), 1), -axial_pitch * (row + 0.5))
            loops.add(magpylib.current.Polyline(current=1.0, vertices=np.hstack((flat, height))))
    return loops


def test_rectangles_are_those_of_magpylib():
    points_m = points_about(RECTANGULAR, 2e-3)
    expected_T = tensor(loops_by_magpylib(RECTANGULAR, 1).getB(points_m.numpy())) / MAGPYLIB_OVER_OURS
    assert relative_error(of_all_loops(points_m, RECTANGULAR), expected_T) < 2e-9  # digits of magpylib's mu0


def test_racetracks_are_the_limit_of_chords_by_magpylib():
    """Chords are off by the square of their length: a factor of 4 from 40 to 80, and nothing is left of it by extrapolation."""
    points_m = points_about(RACETRACK, 4e-3, 60)
    few, many = (
        tensor(loops_by_magpylib(RACETRACK, n + 1).getB(points_m.numpy())) / MAGPYLIB_OVER_OURS
        for n in (40, 80)
    )
    found = of_all_loops(points_m, RACETRACK)
    assert 1e-5 < relative_error(few, found) < 1e-3
    assert relative_error((4.0 * many - few) / 3.0, found) < 1e-7


def test_field_on_the_axis_of_a_rectangle_is_the_closed_formula():
    """Misakian, J. Res. NIST 105, 557 (2000), eq 3, at x = y = 0."""
    one = sided(0.058, 0.038, 0.0, 1.0, 1.0, 2e-3, 2e-3)  # one loop of 60 x 40 mm, 1 mm behind the face
    a, b, z = 0.03, 0.02, np.linspace(-0.1, 0.1, 41)
    root = np.sqrt(a**2 + b**2 + z**2)
    expected_T = MU0_T_M_PER_A * a * b / (np.pi * root) * (1.0 / (a**2 + z**2) + 1.0 / (b**2 + z**2))
    points_m = tensor(np.stack((0.0 * z, 0.0 * z, z - 1e-3), axis=1))
    field_T = of_all_loops(points_m, one).numpy()
    np.testing.assert_allclose(field_T[:, 2], expected_T, rtol=1e-14)
    assert np.abs(field_T[:, :2]).max() < 1e-15 * expected_T.max()


@BOTH
def test_far_away_it_is_a_dipole_of_all_turns_and_areas(winding):
    distance_m = 20.0
    direction = tensor(np.random.default_rng(1).normal(size=(30, 3)))
    direction = direction / direction.norm(dim=1, keepdim=True)
    moment_m2 = 0.0
    for layer in range(3):
        x, y = 0.06 + 2.4e-3 * (layer + 0.5), 0.04 + 2.4e-3 * (layer + 0.5)
        radius = 0.008 + 1.2e-3 * (layer + 0.5) if winding.is_rounded else 0.0
        moment_m2 += 4.0 * (x * y - (4.0 - math.pi) * radius**2)
    points_m = distance_m * direction - tensor([0.0, 0.0, 2e-3])  # about the middle of the winding
    up = tensor([0.0, 0.0, 1.0])
    expected_T = MU0_OVER_4PI * moment_m2 / distance_m**3 * (3.0 * direction[:, 2:] * direction - up)
    assert relative_error(of_all_loops(points_m, winding), expected_T) < 3.0 * (0.04 / distance_m) ** 2


def test_a_racetrack_with_corners_of_half_its_side_is_a_round_winding():
    racetrack = sided(0.06, 0.06, 0.03, 6.0, 4.0, 1.1e-3, 0.9e-3, is_rounded=True)
    numbers = tensor([0.03 + 4 * 0.9e-3, 6.0, 4.0, 1.1e-3, 0.9e-3])
    round_one = Winding(*numbers)
    points_m = points_about(racetrack, 3e-3)
    expected_T = winding_field_per_ampere(points_m, round_one, exact_rule(round_one, points_m))
    assert relative_error(of_all_loops(points_m, racetrack), expected_T) < 1e-12


def test_a_racetrack_with_hardly_any_corners_is_rectangular():
    thin = sided(0.06, 0.04, 0.0, 1.0, 1.0, 1e-9, 1e-9)
    rounded = sided(0.06, 0.04, 1e-9, 1.0, 1.0, 1e-9, 1e-9, is_rounded=True)
    points_m = points_about(thin, 2e-3)
    rules = Rule(1, 1, 0), Rule(1, 1, 8)
    fields = [
        sided_field_per_ampere(points_m, w, rule) for w, rule in zip((thin, rounded), rules, strict=True)
    ]
    assert relative_error(*fields) < 1e-12


@BOTH
def test_divergence_and_curl_vanish(winding):
    points_m = points_about(winding, 2e-3, 60)
    rule = full_sided_rule(winding, points_m)

    def moved(step_m: Tensor) -> Tensor:
        return sided_field_per_ampere(points_m + step_m, winding, rule)

    gradient = jacobian_of(moved, torch.zeros(3).double())
    norm = gradient.flatten(1).norm(dim=1)
    assert (gradient.diagonal(dim1=1, dim2=2).sum(1).abs() < 1e-12 * norm).all()
    assert ((gradient - gradient.mT).flatten(1).norm(dim=1) < 1e-12 * norm).all()


@BOTH
def test_current_through_a_closed_path_is_that_of_all_turns(winding):
    """Ampere's law along a rectangle that links one side of the winding; the current at +x runs along +y."""
    low, high, near, far = -0.024, 0.02, 0.02, 0.05
    nodes, weights = (tensor(v) for v in np.polynomial.legendre.leggauss(80))

    def along(start: tuple[float, float], end: tuple[float, float]) -> Tensor:
        a, b = tensor([start[0], 0.005, start[1]]), tensor([end[0], 0.005, end[1]])
        points_m = 0.5 * (a + b) + 0.5 * nodes[:, None] * (b - a)
        return (0.5 * weights * (of_all_loops(points_m, winding) @ (b - a))).sum()

    corners = [(near, low), (near, high), (far, high), (far, low)]
    total = sum(along(a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True))
    assert float(total) == pytest.approx(MU0_T_M_PER_A * 12, rel=1e-10)


@BOTH
def test_machine_code_torch_and_batches_agree(winding):
    points_m = points_about(winding, 2e-3, 60)
    rule = Rule(3, 2, 15 if winding.is_rounded else 0)
    numbers = [number * tensor([0.98, 1.0, 1.03]) for number in winding.numbers]
    together = sided_field_per_ampere(points_m, SidedWinding(winding.is_rounded, *numbers), rule)
    assert together.shape == (3, len(points_m), 3)
    for i in range(3):
        alone = SidedWinding(winding.is_rounded, *(number[i] for number in numbers))
        torch.testing.assert_close(
            together[i], sided_field_per_ampere(points_m, alone, rule), rtol=0.0, atol=0.0
        )
    by_torch = sided_field_per_ampere(
        points_m.clone().requires_grad_(), SidedWinding(winding.is_rounded, *numbers), rule
    )
    assert relative_error(by_torch.detach(), together) < 1e-13


@BOTH
def test_single_precision_stays_single(winding):
    points_m = points_about(winding, 5e-3, 60)
    rule = Rule(4, 3, 15 if winding.is_rounded else 0)
    single = SidedWinding(winding.is_rounded, *(number.float() for number in winding.numbers))
    field_T = sided_field_per_ampere(points_m.float(), single, rule)
    assert field_T.dtype == torch.float32
    assert relative_error(field_T.double(), sided_field_per_ampere(points_m, winding, rule)) < 1e-4


@BOTH
def test_first_derivatives_by_hand_are_those_of_torch(winding):
    points_m = points_about(winding, 2e-3, 60)
    rule = Rule(3, 2, 15 if winding.is_rounded else 0)

    def field(vector: Tensor, mode: SumMode) -> Tensor:
        there = SidedWinding(winding.is_rounded, *vector[3:])
        return sided_field_per_ampere(points_m + vector[:3], there, rule, mode)

    at = torch.cat((torch.zeros(3).double(), torch.stack(winding.numbers)))
    by_hand, by_torch = (
        jacobian_of(lambda v, m=mode: field(v, m), at) for mode in (SumMode.FIRST_ORDER, SumMode.PLAIN)
    )
    scale = by_torch.abs().amax((0, 1))
    assert (scale > 0.0).all()
    assert ((by_hand - by_torch).abs() < 1e-12 * scale).all()


@BOTH
def test_chosen_rule_keeps_its_tolerance_with_few_nodes(winding):
    large = SidedWinding(winding.is_rounded, *winding.numbers[:3], *map(tensor, (30.0, 12.0, 1e-3, 1e-3)))
    points_m = points_about(large, 10e-3)
    rule, full = choose_rule(large, points_m, 1e-5), full_sided_rule(large, points_m)
    assert rule.axial_nodes * rule.radial_nodes < 0.4 * full.axial_nodes * full.radial_nodes
    assert (rule.steps < full.steps) == winding.is_rounded
    error = relative_error(sided_field_per_ampere(points_m, large, rule), of_all_loops(points_m, large))
    assert error < 1e-5
    assert choose_rule(large, points_m, 0.0) == full


@BOTH
def test_distance_is_that_to_the_nearest_point_of_the_winding(winding):
    """Against a fine mesh of all that the winding fills."""
    radius = 0.008 if winding.is_rounded else 0.0
    mesh = []
    for out in np.linspace(0.0, 3.6e-3, 19):
        corner = radius + out if winding.is_rounded else 0.0
        flat = outline(0.03 + out, 0.02 + out, corner, 40 if winding.is_rounded else 1)
        along = np.linspace(0.0, 1.0, 60)[:, None, None]
        mesh.append((flat[:-1] * (1.0 - along) + flat[1:] * along).reshape(-1, 2))
    flat = np.concatenate(mesh)
    points_m = np.random.default_rng(2).uniform((-0.05, -0.04, -0.02), (0.05, 0.04, 0.02), (150, 3))
    across = np.linalg.norm(points_m[:, None, :2] - flat, axis=2).min(1)
    beyond = np.maximum(np.maximum(points_m[:, 2], -4e-3 - points_m[:, 2]), 0.0)
    found = distance_to_sided(tensor(points_m), winding).numpy()
    expected = np.hypot(across, beyond)
    assert (found <= expected + 3e-6).all()
    assert (expected[expected > 2e-3] - found[expected > 2e-3] < 3e-4).all()
    inside_m = tensor([[0.0315, 0.0, -2e-3], [0.01, -0.0235, -1e-4], [-0.03 - 1e-4, 0.011, -3.9e-3]])
    assert (distance_to_sided(inside_m, winding) == 0.0).all()
