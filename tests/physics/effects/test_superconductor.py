"""Windings that are magnetised: against hollow magnets and heaps of dipoles by magpylib."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest

from estimator.units import MU0_T_M_PER_A
from tests.physics.effects.laboratory import MU0_RATIO, Loops, added_T, assert_same_field, readings

# Two windings on one bobbin, thick enough that their cross-sections matter; the second one is as long as it is wide.
RIG = """
schema_version: 1
name: bobbin
movers: {mapper: {motion: pose}}
coils:
  coil: {superconducting: true, radius_mm: 120, wire_radius_mm: 1, axial_loops: 40, radial_loops: 10}
  other: {radius_mm: 110, wire_radius_mm: 1, axial_loops: 20, radial_loops: 5, world_from_coil: {z_mm: 100}}
sensors:
  probe: {carried_by: mapper, noise_uT: 5}
"""
INNER_M, OUTER_M, LENGTH_M = 0.1, 0.12, 0.08
BORE_M = np.array(
    [
        [0.0, 0.0, -0.03],
        [0.02, 0.03, -0.01],
        [-0.05, 0.01, 0.03],
        [0.03, -0.04, -0.12],
        [0.0, 0.06, -0.07],
        [0.2, 0.1, 0.1],
    ]
)
OFF = readings(BORE_M, (0.0, 0.0))
PARTS, ANGLES = (12, 24), 48


def test_uniform_magnetisation_along_the_axis_is_that_of_a_hollow_magnet():
    magnet = magpylib.magnet.CylinderSegment(
        polarization=(0.0, 0.0, 0.02),
        dimension=(INNER_M, OUTER_M, LENGTH_M, 0.0, 360.0),
        position=(0.0, 0.0, -0.5 * LENGTH_M),
    )
    difference_T = added_T(OFF, {"filament_magnetisation[coil]": {"axial_T": 0.02}}, RIG)
    assert_same_field(difference_T, MU0_RATIO * magnet.getB(BORE_M), 3e-3)


@pytest.mark.parametrize("key", ["radial_T", "fan_T"])
def test_magnetisation_outwards_is_that_of_dipoles_that_point_outwards(key):
    radius_m, height_m = cells()
    outwards_T = (
        0.02 * np.ones_like(height_m) if key == "radial_T" else 0.02 * (1.0 + 2.0 * height_m / LENGTH_M)
    )
    difference_T = added_T(OFF, {"filament_magnetisation[coil]": {key: 0.02}}, RIG)
    assert_same_field(difference_T, dipoles_T(radius_m, height_m, outwards_T, 0.0 * height_m), 3e-3)


@pytest.mark.parametrize("powered", ["coil", "other"])
def test_screening_is_a_share_of_the_present_field_the_other_way(powered):
    """Of the winding's own current and of its neighbour's: filaments finer than the cells, which lie between them."""
    radius_m, height_m = cells()
    wound = {"coil": (INNER_M, OUTER_M, -LENGTH_M, 0.0, 400), "other": (0.1, 0.11, 0.06, 0.1, 100)}
    source = filaments(*wound[powered])
    field = source.field_T(np.column_stack((radius_m, 0.0 * radius_m, height_m)))
    at = readings(BORE_M, (1.0, 0.0) if powered == "coil" else (0.0, 1.0))
    difference_T = added_T(at, {"filament_magnetisation[coil]": {"susceptibility": 0.25}}, RIG)
    assert_same_field(
        difference_T, dipoles_T(radius_m, height_m, -0.25 * field[:, 0], -0.25 * field[:, 2]), 2e-2
    )


def test_what_is_left_does_not_know_the_current():
    left = {"filament_magnetisation[coil]": {"axial_T": 0.01, "fan_T": 0.02}}
    assert_same_field(added_T(readings(BORE_M, (3.0, -1.0)), left, RIG), added_T(OFF, left, RIG), 1e-9)
    assert np.abs(added_T(OFF, {"filament_magnetisation[coil]": {"susceptibility": 0.5}}, RIG)).max() == 0.0


def test_coils_that_a_stage_carries_together_are_where_they_stand_in_the_room():
    """A stage that reports displacements knows no place of its flange: both coils have the same one."""
    on_stage = RIG.replace("{motion: pose}}", "{motion: pose}, stage: {motion: displacement}}")
    for name in ("  coil: {", "  other: {"):
        on_stage = on_stage.replace(name, f"{name}carried_by: stage, ")
    on_stage = on_stage.replace("world_from_coil:", "world_from_coil0:")
    at, screened = readings(BORE_M, (0.0, 1.0)), {"filament_magnetisation[coil]": {"susceptibility": 0.25}}
    in_the_room_T = added_T(at, screened, RIG)
    at.motion["stage"] = 0.0 * at.motion["mapper"]
    assert_same_field(added_T(at, screened, on_stage), in_the_room_T, 1e-9)


def test_coil_that_another_arm_carries_is_not_screened():
    """Its field changes with every pose; what it leaves behind is not known."""
    apart = RIG.replace("other: {", "other: {carried_by: arm, ").replace(
        "world_from_coil", "flange_from_coil"
    )
    apart = apart.replace("movers: {", "movers: {arm: {motion: pose}, ")
    at = readings(BORE_M, (0.0, 1.0))
    at.motion["arm"] = 0.0 * at.motion["mapper"]
    assert np.abs(added_T(at, {"filament_magnetisation[coil]": {"susceptibility": 0.5}}, apart)).max() == 0.0


def cells() -> tuple[np.ndarray, np.ndarray]:
    """Radius and height of the middles of equal cells of the winding's cross-section."""
    n_radial, n_axial = PARTS
    radius_m = INNER_M + (np.arange(n_radial) + 0.5) * (OUTER_M - INNER_M) / n_radial
    height_m = -(np.arange(n_axial) + 0.5) * LENGTH_M / n_axial
    radius, height = np.meshgrid(radius_m, height_m, indexing="ij")
    return radius.ravel(), height.ravel()


def filaments(inner_m: float, outer_m: float, back_m: float, front_m: float, turns: int) -> Loops:
    """A winding as twice as many filaments each way as there are cells: a cell's middle lies between four of them."""
    n_radial, n_axial = 2 * PARTS[0], 2 * PARTS[1]
    radius_m = inner_m + (np.arange(n_radial) + 0.5) * (outer_m - inner_m) / n_radial
    height_m = back_m + (np.arange(n_axial) + 0.5) * (front_m - back_m) / n_axial
    radius, height = (grid.ravel() for grid in np.meshgrid(radius_m, height_m, indexing="ij"))
    return Loops(radius, height, np.full(radius.shape, turns / len(radius)))


def dipoles_T(
    radius_m: np.ndarray, height_m: np.ndarray, outwards_T: np.ndarray, along_T: np.ndarray
) -> np.ndarray:
    """Field of the cells as rings of dipoles."""
    turn = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
    unit = np.column_stack((np.cos(turn), np.sin(turn), 0.0 * turn))
    area_m2 = (OUTER_M - INNER_M) * LENGTH_M / len(radius_m)
    volume_m3 = area_m2 * 2.0 * np.pi * radius_m / ANGLES
    at_m = radius_m[:, None, None] * unit + height_m[:, None, None] * np.array([0.0, 0.0, 1.0])
    moment = outwards_T[:, None, None] * unit + along_T[:, None, None] * np.array([0.0, 0.0, 1.0])
    moment_A_m2 = moment * volume_m3[:, None, None] / MU0_T_M_PER_A
    at_m, moment_A_m2 = at_m.reshape(-1, 3), moment_A_m2.reshape(-1, 3)
    field = np.zeros_like(BORE_M)
    for i, point_m in enumerate(BORE_M):
        arm = point_m - at_m
        r2 = (arm**2).sum(1, keepdims=True)
        field[i] = (
            1e-7 * (3.0 * arm * (arm * moment_A_m2).sum(1, keepdims=True) - r2 * moment_A_m2) * r2**-2.5
        ).sum(0)
    return field
