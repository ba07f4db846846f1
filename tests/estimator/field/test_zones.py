"""Rules by distance: every point gets the tolerance, and what it gets depends on no other point."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from estimator.field.winding import Winding, distance_to_winding, exact_rule, winding_field_per_ampere
from estimator.field.zones import Zone, zones_of
from tests.estimator.field.test_winding import SMALL, TABLE_TOP, points_around, winding

NARROW = winding(0.012, 30.0, 11.0, 1e-3, 1e-3)  # the bore is narrower than the distance of most points


def by_zones(points_m: Tensor, coil: Winding, tolerance: float) -> tuple[Tensor, tuple[Zone, ...]]:
    zones = zones_of(coil, distance_to_winding(points_m, coil), tolerance)
    field = torch.full_like(points_m, torch.nan)
    for zone in zones:
        field[zone.points] = winding_field_per_ampere(points_m[zone.points], coil, zone.rule)
    return field, zones


@pytest.mark.parametrize("coil", [TABLE_TOP, SMALL, NARROW])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_every_point_is_within_the_tolerance_however_near(coil, tolerance):
    size_m = float(coil.radius_m)
    points_m = torch.cat(
        [points_around(coil, 0.02 * 4**i * size_m, 0.04 * 4**i * size_m, 60) for i in range(3)]
    )
    points_m = torch.cat((points_m, 20.0 * points_m, 200.0 * points_m))
    nearest_m = torch.tensor([[size_m + 1e-5, 0.0, -0.004], [size_m - 0.003, 0.0, 1e-4]], dtype=torch.float64)
    points_m = torch.cat((points_m, nearest_m))
    field, zones = by_zones(points_m, coil, tolerance)
    exact = winding_field_per_ampere(points_m, coil, exact_rule(coil, points_m))
    error = (field - exact).norm(dim=-1) / exact.norm(dim=-1)
    assert float(error.max()) <= max(tolerance, 1e-12)
    loops = [zone.rule.axial_nodes * zone.rule.radial_nodes for zone in zones]
    assert loops == sorted(loops, reverse=True)
    assert loops[-1] < 0.5 * loops[0]
    assert sorted(torch.cat([zone.points for zone in zones]).tolist()) == list(range(len(points_m)))


def test_a_point_near_the_winding_costs_the_others_nothing():
    far_m = points_around(TABLE_TOP, 0.05, 0.1, 100)
    near_m = points_around(TABLE_TOP, 1e-4, 2e-4, 1)
    alone, zones = by_zones(far_m, TABLE_TOP, 1e-6)
    together, zones_of_all = by_zones(torch.cat((far_m, near_m)), TABLE_TOP, 1e-6)
    torch.testing.assert_close(together[:100], alone, rtol=1e-14, atol=0.0)
    assert len(zones_of_all) == len(zones) + 1
    assert zones_of_all[0].points.tolist() == [100]


def test_points_inside_go_with_the_farthest_and_tolerance_0_takes_every_loop():
    points_m = torch.tensor([[0.045, 0.0, -0.01], [0.0, 0.0, 0.1]], dtype=torch.float64)
    assert [
        zone.points.tolist() for zone in zones_of(TABLE_TOP, distance_to_winding(points_m, TABLE_TOP), 1e-6)
    ][-1][0] == 0
    (zone,) = zones_of(TABLE_TOP, distance_to_winding(points_m[1:], TABLE_TOP), 0.0)
    assert (zone.rule.axial_nodes, zone.rule.radial_nodes) == (48, 25)
