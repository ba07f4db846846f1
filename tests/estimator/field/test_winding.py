"""Windings: the Gauss sum against every single loop, derivatives, refusals, and a second library."""

from __future__ import annotations

from itertools import pairwise

import magpylib
import numpy as np
import pytest
import torch
from scipy.interpolate import BarycentricInterpolator
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.func import jacfwd, jacrev

from estimator.field import winding as winding_module
from estimator.field.loop import loop_field
from estimator.field.winding import (
    Winding,
    distance_to_winding,
    exact_rule,
    winding_field_per_ampere,
)
from estimator.field.winding_shape import NODE_LADDER, Rule, choose_rule
from tests import by_zones
from tests.by_zones import winding_field


def tensor(value: object) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def winding(
    radius_m: float, axial: float, radial: float, axial_pitch_m: float, radial_pitch_m: float
) -> Winding:
    return Winding(*map(tensor, (radius_m, axial, radial, axial_pitch_m, radial_pitch_m)))


TABLE_TOP = winding(0.051, 48.0, 25.0, 0.98e-3, 0.98e-3)  # Table 2 of the paper
SMALL = winding(0.03, 6.0, 4.0, 1.74e-3, 1.06e-3)  # pitches of the MICE coils


def every_loop(points_m: Tensor, coil: Winding) -> Tensor:
    """The paper's sum, loop by loop (eq 9-10), in Cartesian components."""
    n_a, n_r = int(coil.axial_loops), int(coil.radial_loops)
    total = torch.zeros_like(points_m)
    for n in range(1, n_r + 1):
        loop_radius_m = coil.radius_m - coil.radial_pitch_m * (n - 0.5)
        depths_m = coil.axial_pitch_m * (torch.arange(1, n_a + 1, dtype=torch.float64) - 0.5)
        shifted = points_m[:, None, :].repeat(1, n_a, 1)
        shifted[..., 2] += depths_m
        total += loop_field(shifted, loop_radius_m).sum(1)
    return total


def points_around(coil: Winding, nearest_m: float, farthest_m: float, number: int, seed: int = 0) -> Tensor:
    """Random points on all sides whose distance to the cross-section lies between the two."""
    random = np.random.default_rng(seed)
    margin_m = 1.2 * min(farthest_m, 0.15)
    selected_m = torch.empty(0, 3, dtype=torch.float64)
    while len(selected_m) < number:
        rho = random.uniform(0.0, float(coil.radius_m) + margin_m, 20_000)
        azimuth = random.uniform(0.0, 2.0 * np.pi, 20_000)
        z = random.uniform(-float(coil.length_m) - margin_m, margin_m, 20_000)
        points = torch.from_numpy(np.stack((rho * np.cos(azimuth), rho * np.sin(azimuth), z), -1))
        distance_m = distance_to_winding(points, coil)
        selected_m = torch.cat((selected_m, points[(distance_m >= nearest_m) & (distance_m < farthest_m)]))
    return selected_m[:number]


def sides(points_m: Tensor, coil: Winding) -> dict[str, Tensor]:
    rho_m, z_m = points_m[:, :2].norm(dim=1), points_m[:, 2]
    behind = -coil.length_m
    return {
        "front": z_m > 0.0,
        "back": z_m < behind,
        "side": (z_m <= 0.0) & (z_m >= behind) & (rho_m > coil.radius_m),
        "bore": (z_m <= 0.0) & (z_m >= behind) & (rho_m < coil.radius_m - coil.thickness_m),
    }


def relative_error(field: Tensor, reference: Tensor) -> Tensor:
    return (field - reference).norm(dim=-1) / reference.norm(dim=-1)


def test_loops_lie_where_the_paper_puts_them():
    """One node per loop, and nothing but the two ends of the cross-section given by hand."""
    coil = winding(0.05, 2.0, 2.0, 2e-3, 1e-3)
    points_m = tensor([[0.0, 0.0, 0.01], [0.02, -0.03, 0.04]])
    by_hand = sum(
        loop_field(points_m - tensor([0.0, 0.0, z]), tensor(a))
        for a in (0.0495, 0.0485)
        for z in (-1e-3, -3e-3)
    )
    ours = winding_field_per_ampere(points_m, coil, exact_rule(coil, points_m))
    torch.testing.assert_close(ours, by_hand, rtol=1e-13, atol=0.0)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_gauss_sum_meets_the_tolerance_all_around_the_table_top_coil(tolerance):
    points_m = points_around(TABLE_TOP, 5e-3, 0.15, 600)
    error = relative_error(winding_field(points_m, TABLE_TOP, tolerance), every_loop(points_m, TABLE_TOP))
    for side, chosen in sides(points_m, TABLE_TOP).items():
        assert chosen.sum() >= 5, side
        assert error[chosen].max() < tolerance, side
    assert error.max() > 1e-3 * tolerance  # a sum of all loops would pass too, but would not be the Gauss sum


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
@pytest.mark.parametrize(("nearest_m", "farthest_m"), [(2e-3, 5e-3), (1e-3, 2e-3), (0.3e-3, 1e-3)])
def test_gauss_sum_refines_itself_near_the_winding(nearest_m, farthest_m, tolerance):
    points_m = points_around(TABLE_TOP, nearest_m, farthest_m, 150)
    error = relative_error(winding_field(points_m, TABLE_TOP, tolerance), every_loop(points_m, TABLE_TOP))
    assert error.max() < tolerance


def test_near_points_do_not_make_far_ones_expensive(monkeypatch):
    spent = []
    original = by_zones.winding_field_per_ampere

    def counting(points_m: Tensor, coil: Winding, rule: Rule) -> Tensor:
        spent.append(len(points_m) * rule.axial_nodes * rule.radial_nodes)
        return original(points_m, coil, rule)

    far = points_around(TABLE_TOP, 0.04, 0.1, 1500)
    both = torch.cat((far, points_around(TABLE_TOP, 0.3e-3, 0.6e-3, 10)))
    monkeypatch.setattr(by_zones, "winding_field_per_ampere", counting)
    winding_field(both, TABLE_TOP, 1e-6)
    assert sum(spent) < 0.5 * len(both) * 48 * 25


@pytest.mark.parametrize("seed", range(12))
def test_tolerance_holds_for_windings_of_any_shape(seed):
    random = np.random.default_rng(seed)
    n_a, n_r = random.integers(1, 120), random.integers(1, 40)
    axial_pitch_m, radial_pitch_m = random.uniform(0.3e-3, 3e-3, 2)
    radius_m = radial_pitch_m * n_r + random.uniform(0.5e-3, 0.1)
    coil = winding(radius_m, float(n_a), float(n_r), axial_pitch_m, radial_pitch_m)
    tolerance = 10.0 ** -random.integers(3, 9)
    points_m = points_around(coil, 0.3e-3, 0.3, 80, seed)
    error = relative_error(winding_field(points_m, coil, tolerance), every_loop(points_m, coil))
    assert error.max() < tolerance


def test_tolerance_zero_is_the_sum_over_every_loop():
    points_m = points_around(TABLE_TOP, 0.3e-3, 0.15, 200)
    error = relative_error(winding_field(points_m, TABLE_TOP, 0.0), every_loop(points_m, TABLE_TOP))
    assert error.max() < 1e-13


def test_rule_is_the_smallest_of_the_ladder_that_suffices():
    points_m = points_around(TABLE_TOP, 0.03, 0.1, 30)
    rule = choose_rule(TABLE_TOP, points_m, 1e-6)
    reference = every_loop(points_m, TABLE_TOP)
    below = {n: smaller for smaller, n in pairwise(NODE_LADDER)}
    for fewer in (
        Rule(below[rule.axial_nodes], 25, rule.steps),
        Rule(rule.axial_nodes, below[rule.radial_nodes], rule.steps),
    ):
        error = relative_error(winding_field_per_ampere(points_m, TABLE_TOP, fewer), reference)
        assert error.max() > 1e-6 / 3.0
    assert rule.axial_nodes * rule.radial_nodes < 100


@pytest.mark.parametrize("which", ["axial", "radial"])
def test_real_valued_counts_lie_on_the_smooth_curve_through_the_whole_ones(which):
    """The curve is the polynomial through ten sums over every loop; only whole counts enter it."""
    points_m = points_around(TABLE_TOP, 0.02, 0.06, 8)

    def coil(count: float) -> Winding:
        return (
            winding(0.051, count, 25.0, 0.98e-3, 0.98e-3)
            if which == "axial"
            else winding(0.051, 48.0, count, 0.98e-3, 0.98e-3)
        )

    middle = 48 if which == "axial" else 25
    counts = np.arange(middle - 5, middle + 5)
    sums = np.stack([every_loop(points_m, coil(float(count))).numpy() for count in counts])
    curve = BarycentricInterpolator(counts.astype(float), sums)
    rule = Rule(20, 12, 6)
    for count in (middle - 0.7, middle - 0.5, middle + 0.1):
        ours = winding_field_per_ampere(points_m, coil(count), rule)
        assert relative_error(ours, torch.from_numpy(curve(count))).max() < 1e-8


GEOMETRY = (0.051, 48.3, 24.6, 0.98e-3, 0.95e-3)
STEPS = (1e-4, 0.3, 0.3, 1e-5, 1e-5)


@pytest.mark.parametrize("index", range(5), ids=Winding.__dataclass_fields__)
def test_derivative_in_the_winding_is_the_limit_of_central_differences(index):
    points_m = points_around(TABLE_TOP, 8e-3, 0.08, 10)
    rule = Rule(24, 16, 6)

    def field(value: Tensor) -> Tensor:
        numbers = [tensor(number) for number in GEOMETRY]
        numbers[index] = value
        return winding_field_per_ampere(points_m, Winding(*numbers), rule)

    def error(step: float) -> float:
        value = GEOMETRY[index]
        difference = (field(tensor(value + step)) - field(tensor(value - step))) / (2.0 * step)
        return relative_error(difference, derivative).max().item()

    derivative = jacfwd(field)(tensor(GEOMETRY[index]))
    torch.testing.assert_close(jacrev(field)(tensor(GEOMETRY[index])), derivative, rtol=1e-9, atol=1e-14)
    assert error(STEPS[index]) / error(0.5 * STEPS[index]) == pytest.approx(4.0, rel=0.05)
    assert error(1e-2 * STEPS[index]) < 1e-6


def test_derivative_in_the_position_is_the_limit_of_central_differences():
    points_m = points_around(TABLE_TOP, 8e-3, 0.08, 10)
    rule = Rule(20, 12, 6)

    def field(shift_m: Tensor) -> Tensor:
        return winding_field_per_ampere(points_m + shift_m, TABLE_TOP, rule)

    gradient = jacfwd(field)(torch.zeros(3, dtype=torch.float64))

    def error(step: float) -> float:
        columns = [(field(step * e) - field(-step * e)) / (2.0 * step) for e in torch.eye(3).double()]
        difference = torch.stack(columns, -1) - gradient
        return (difference.flatten(1).norm(dim=1) / gradient.flatten(1).norm(dim=1)).max().item()

    assert error(4e-4) / error(2e-4) == pytest.approx(4.0, rel=0.1)
    assert error(4e-6) < 1e-6


def test_distance_is_that_to_the_nearest_point_of_the_cross_section():
    points_m = torch.from_numpy(np.random.default_rng(3).uniform(-0.1, 0.1, size=(300, 3)))
    grid = torch.stack(
        torch.meshgrid(
            torch.linspace(0.051 - 25 * 0.98e-3, 0.051, 401).double(),
            torch.linspace(-48 * 0.98e-3, 0.0, 401).double(),
            indexing="ij",
        ),
        -1,
    ).reshape(-1, 2)
    flat = torch.stack((points_m[:, :2].norm(dim=1), points_m[:, 2]), -1)
    expected = torch.cdist(flat, grid).min(1).values
    ours = distance_to_winding(points_m, TABLE_TOP)
    assert (ours == 0.0).any()
    assert (ours - expected).abs().max() < 1.2e-4  # half the grid's diagonal


def test_batches_equal_one_by_one_even_where_they_are_cut_into_chunks(monkeypatch):
    random = np.random.default_rng(4)
    radius_m, counts = tensor(random.uniform(0.04, 0.06, (3, 1))), tensor(random.uniform(20.0, 30.0, (3, 1)))
    ones = torch.ones(3, 1, dtype=torch.float64)
    coils = Winding(radius_m, counts, 8.0 * ones, 1e-3 * ones, 1.2e-3 * ones)
    points_m = tensor(random.uniform(0.02, 0.1, (2, 7, 3)))
    rule = Rule(6, 4, 6)
    together = winding_field_per_ampere(points_m, coils, rule)
    assert together.shape == (3, 2, 7, 3)
    for i, j in np.ndindex(3, 2):
        alone = Winding(*(value[i, 0] for value in vars(coils).values()))
        expected = winding_field_per_ampere(points_m[j], alone, rule)
        torch.testing.assert_close(together[i, j], expected, rtol=1e-13, atol=1e-20)
    for elements in (1, 60, 400):
        monkeypatch.setattr(winding_module, "ELEMENTS_PER_CHUNK", elements)
        chunked = winding_field_per_ampere(points_m, coils, rule)
        torch.testing.assert_close(chunked, together, rtol=1e-13, atol=1e-20)


def test_whole_numbered_winding_rounds_its_counts_and_keeps_one_loop_at_least():
    coil = winding(0.05, 47.6, 0.3, 1e-3, 1e-3).with_integer_loops()
    assert (coil.axial_loops.item(), coil.radial_loops.item()) == (48.0, 1.0)
    assert (coil.radius_m.item(), coil.axial_pitch_m.item()) == (0.05, 1e-3)


def test_second_library_agrees():
    """magpylib's loops (their mu0 differs by 8e-11), at a random pose, outside, in front and in the bore."""
    rotation = Rotation.random(random_state=5)
    position_m = np.array([0.1, -0.2, 0.3])
    loops = magpylib.Collection(
        *(
            magpylib.current.Circle(
                current=1.0, diameter=2 * (0.03 - 1.06e-3 * (r + 0.5)), position=(0, 0, z)
            )
            for r in range(4)
            for z in -1.74e-3 * (np.arange(6) + 0.5)
        )
    )
    loops.rotate(rotation).move(position_m)
    points_coil_m = points_around(SMALL, 1e-3, 0.1, 50)
    world_m = rotation.apply(points_coil_m.numpy()) + position_m
    theirs = rotation.inv().apply(loops.getB(world_m))
    ours = winding_field(points_coil_m, SMALL, 0.0)
    assert relative_error(ours, torch.from_numpy(theirs)).max() < 1e-9
