"""Windings of any shape answer alike: what holds for one holds for all."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.field.sided import SidedWinding
from estimator.field.winding import Winding
from estimator.field.winding_shape import NODE_LADDER, Rule, WindingShape, choose_rule


def tensors(*numbers: float) -> list[torch.Tensor]:
    return [torch.tensor(number, dtype=torch.float64) for number in numbers]


LOOPS = (12.0, 6.0, 1e-3, 1e-3)
SHAPES = [
    Winding(*tensors(0.04, *LOOPS)),
    SidedWinding(False, *tensors(0.06, 0.04, 0.0, *LOOPS)),
    SidedWinding(True, *tensors(0.06, 0.04, 0.008, *LOOPS)),
]


@pytest.fixture(params=SHAPES, ids=["round", "rectangular", "racetrack"])
def winding(request: pytest.FixtureRequest) -> WindingShape:
    return request.param


def test_winding_is_made_again_of_its_numbers(winding):
    again = winding.like(winding.numbers)
    assert again == winding
    half = winding.like([*winding.numbers[:-4], *tensors(11.6, 0.2, 1e-3, 1e-3)]).with_integer_loops()
    assert (type(half), half.kind) == (type(winding), winding.kind)
    assert (float(half.axial_loops), float(half.radial_loops)) == (12.0, 1.0)


@pytest.mark.parametrize("distance_m", [0.5e-3, 0.01, 0.05])
def test_contour_lies_at_its_distance_outside_the_winding(winding, distance_m):
    """Around corners points may lie nearer to another side, never farther off."""
    at_m = winding.distance_m(winding.contour_m(distance_m))
    assert len(at_m) >= 20
    assert (at_m <= distance_m * (1.0 + 1e-9)).all()
    assert float(at_m.max()) == pytest.approx(distance_m, rel=1e-6)
    assert (winding.contour_m(distance_m).norm(dim=-1) < 4.0 * winding.half_width_m + 2.0 * distance_m).all()


def test_chosen_rule_has_the_field_of_all_loops_to_the_tolerance(winding):
    points_m = winding.contour_m(0.03)
    full, few = choose_rule(winding, points_m, 0.0), choose_rule(winding, points_m, 1e-4)
    assert full == winding.full_rule(points_m)
    assert few.axial_nodes * few.radial_nodes < full.axial_nodes * full.radial_nodes
    field, expected = (winding.field_by(rule)(points_m) for rule in (few, full))
    assert ((field - expected).norm(dim=-1) <= 1e-4 * expected.norm(dim=-1)).all()


@pytest.mark.parametrize("distance_m", [1e-3, 4e-3, 0.016, 0.064])
def test_no_smaller_rule_of_the_ladder_would_do(winding, distance_m):
    """The rule is found by halving; a search through all of them finds no other."""
    points_m, tolerance = winding.contour_m(distance_m)[:48], 1e-6
    expected = winding.field_by(winding.full_rule(points_m))(points_m)

    def does(rule: Rule) -> bool:
        error = (winding.field_by(rule)(points_m) - expected).norm(dim=-1)
        return bool((error <= tolerance / 3.0 * expected.norm(dim=-1)).all())

    rule = winding.full_rule(points_m)
    for number in ("steps", "axial_nodes", "radial_nodes")[0 if winding.kind else 1 :]:
        fewer = [replace(rule, **{number: n}) for n in NODE_LADDER if n < getattr(rule, number)]
        rule = next(filter(does, fewer), rule)
    assert choose_rule(winding, points_m, tolerance) == rule
