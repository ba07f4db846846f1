"""Coils are drawn where rig and motion put them, as wide as their mean turn."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator import load_rig
from estimator.live.picture import CoilOutline, outlines, places
from estimator.readings.observations import Observations
from estimator.rig.bodies import SidedCoil
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig

CONFIGS = Path(__file__).parents[3] / "configs"


def of(rig: Rig, readings: Observations) -> list[CoilOutline]:
    return outlines(rig, nominal_tensors(rig), readings)


def at_rest(rig: Rig) -> Observations:
    """One reading with nothing moved."""
    zero = torch.zeros(1, dtype=torch.float64)
    still = {mover.name: zero.expand(1, 6) for mover in rig.movers}
    return Observations.of(zero.expand(1, len(rig.coils)), still, zero.expand(1, 3))


def test_a_coil_that_is_carried_stands_where_its_last_place_was_seen_from(small_session, small_rig):
    """Its frame holds the places, and the sensor stays where it is: origin and axes lead from one to the other."""
    readings, values = small_session.observations, nominal_tensors(small_rig)
    for key, angle_rad in {"rx": 0.3, "ry": -0.2, "rz": 0.4}.items():
        values[f"coil1.world_from_coil0.{key}_rad"] = torch.tensor(angle_rad, dtype=torch.float64)
    sensor_m = [small_rig.nominal_values()[f"hall.world_from_sensor.{axis}_m"] for axis in "xyz"]
    for n in (1, 7, len(readings)):
        part = readings.rows(torch.arange(n))
        (outline,) = outlines(small_rig, values, part)
        place = places(small_rig, values, part, range(1, n + 1))[-1]
        axes = np.stack([outline.x_axis, outline.y_axis, np.cross(outline.x_axis, outline.y_axis)])
        world_m = np.array(outline.origin_m) + np.array(place.position_m) @ axes
        assert world_m.tolist() == pytest.approx(sensor_m, abs=1e-7)


def test_a_round_coil_is_a_circle_of_its_mean_radius_in_the_middle_of_its_winding(small_session, small_rig):
    (outline,) = of(small_rig, small_session.observations)
    keys = ("radius_m", "radial_loops", "radial_pitch_m", "axial_loops", "axial_pitch_m")
    radius_m, layers, layer_m, turns, turn_m = (small_rig.nominal_values()[f"coil1.{key}"] for key in keys)
    assert outline.radius_m == pytest.approx(radius_m - 0.5 * layers * layer_m)
    assert outline.depth_m == pytest.approx(0.5 * turns * turn_m)
    assert outline.straight_m == (0.0, 0.0)


@pytest.mark.parametrize(("is_rounded", "radius_m"), [(False, 0.0), (True, 5e-3 + 4e-3)])
def test_a_coil_with_straight_sides_is_a_rectangle_between_its_layers(is_rounded, radius_m):
    """A bore of 160 mm by 120 mm and eight layers of 1 mm: the mean turn has 168 mm by 128 mm from side to side."""
    rig = load_rig(CONFIGS / "rectangular_helmholtz.yaml")
    coils = tuple(replace(coil, is_rounded=is_rounded) for coil in rig.wound if isinstance(coil, SidedCoil))
    values = nominal_tensors(rig)
    corners = {
        f"{coil.name}.inner_corner_radius_m": values[f"{coil.name}.inner_side_x_m"].new_tensor(5e-3)
        for coil in coils
    }
    first, second = outlines(replace(rig, coils=coils), {**values, **corners}, at_rest(rig))
    for outline in (first, second):
        assert outline.radius_m == pytest.approx(radius_m)
        assert outline.straight_m == pytest.approx((0.168 - 2 * radius_m, 0.128 - 2 * radius_m))
    assert math.dist(first.origin_m, second.origin_m) > 0.05
