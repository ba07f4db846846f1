"""Two coils that face each other and pull or push: their brackets give way. The rig file knows of no force.

Forces are sums over pieces of a mean loop in the field of the other winding; nothing is shared with the estimator.
"""

from __future__ import annotations

import csv
from itertools import product
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.coil import Winding, blocks_of, circular_field
from tests.hidden.protocols import Array

WINDING = Winding(radius_m=0.045, wire_radius_m=0.4e-3, axial_loops=48, radial_loops=20)
NAMES = ("left", "right")
ANGLE_DEG = 15.0  # between the axes
DISTANCE_M = 0.06  # of the front faces from the middle of the map
NOISE_T = 5e-6
HALF_WIDTH_M = 0.02  # of the map
LEVELS_A = (2.5, 5.0)
N_PIECES = 90  # of a mean loop
POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
RIG = """
schema_version: 1
name: two coils on brackets
movers: {mapper: {motion: pose}}
sensors:
  probe: {carried_by: mapper, noise_uT: {prior: {log_normal: {median: 6, relative_sd: 0.3}}}}
coils:
"""
COIL = """
  {name}:
    radius_mm: {{prior: {{normal: {{mean: 45, sd: 0.3}}}}}}
    wire_radius_mm: 0.4
    axial_loops: 48
    radial_loops: 20
    current_gain: {{prior: {{normal: {{mean: 1, sd: 0.01}}}}}}
    world_from_coil:
      x_mm: {{prior: {{normal: {{mean: {x}, sd: 1}}}}}}
      y_mm: {{prior: {{normal: {{mean: 0, sd: 1}}}}}}
      z_mm: {{prior: {{normal: {{mean: {z}, sd: 1}}}}}}
      ry_deg: {ry}
      tilt_x_deg: {{prior: {{normal: {{mean: 0, sd: 1}}}}}}
      tilt_y_deg: {{prior: {{normal: {{mean: 0, sd: 1}}}}}}
"""


class Truth(Protocol):
    """What a probe sees."""

    def field_T(self, currents_A: Array, at_m: Array) -> Array:
        """In the world, at points, at one setting of the currents."""


class PulledPair:
    """The truth of the pair.

    Args:
        compliances_m_per_N: How soft the brackets of the left and the right coil are.
        rng: Draws how far the coils stand from where the rig file has them.
    """

    def __init__(self, compliances_m_per_N: tuple[float, float], rng: np.random.Generator) -> None:
        self.compliances_m_per_N = compliances_m_per_N
        self.coil = circular_field(blocks_of(WINDING), nodes=30)
        self.poses = [
            (
                turn * Rotation.from_rotvec(np.deg2rad(0.5) * rng.normal(size=3) * [1, 1, 0]),
                at_m + 5e-4 * rng.normal(size=3),
            )
            for turn, at_m in nominal_poses()
        ]

    def force_N(self, number: int, currents_A: Array) -> Array:
        """Force on one coil by the other, in the world."""
        turn, place_m = self.poses[number]
        angle = 2.0 * np.pi * np.arange(N_PIECES) / N_PIECES
        radius_m = float(WINDING.radii_m.mean())
        height_m = -WINDING.axial_loops * WINDING.wire_radius_m  # turns lie two radii apart
        circle_m = np.stack(
            (radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(N_PIECES, height_m)), axis=1
        )
        pieces_m = (
            radius_m * 2.0 * np.pi / N_PIECES * np.stack((-np.sin(angle), np.cos(angle), 0.0 * angle), axis=1)
        )
        felt_T = currents_A[1 - number] * self._of(1 - number, turn.apply(circle_m) + place_m)
        turns = WINDING.axial_loops * WINDING.radial_loops
        return np.asarray(turns * currents_A[number] * np.cross(turn.apply(pieces_m), felt_T).sum(0))

    def field_T(self, currents_A: Array, at_m: Array) -> Array:
        """At points, with both coils where their brackets let them go."""
        total = np.zeros_like(at_m)
        for number, compliance in enumerate(self.compliances_m_per_N):
            shift_m = compliance * self.force_N(number, currents_A)
            total += currents_A[number] * self._of(number, at_m - shift_m)
        return total

    def _of(self, number: int, at_m: Array) -> Array:
        turn, place_m = self.poses[number]
        return np.asarray(turn.apply(self.coil(turn.inv().apply(at_m - place_m))))


def nominal_poses() -> list[tuple[Rotation, Array]]:
    """Both front faces look at the middle of the map."""
    rotations = [Rotation.from_euler("y", turn, degrees=True) for turn in (90.0, -90.0 - ANGLE_DEG)]
    return [(rotation, -DISTANCE_M * rotation.apply([0.0, 0.0, 1.0])) for rotation in rotations]


def write(folder: Path, truth: Truth, places: int, rng: np.random.Generator) -> None:
    """The rig file, and readings at some places for each setting of the currents, in random order, with noise."""
    rig = RIG
    for name, (rotation, at_m) in zip(NAMES, nominal_poses(), strict=True):
        ry_deg = np.rad2deg(rotation.as_rotvec()[1])
        rig += COIL.format(
            name=name, x=round(1e3 * at_m[0], 6), z=round(1e3 * at_m[2], 6), ry=round(ry_deg, 6)
        )
    (folder / "rig.yaml").write_text(rig, encoding="utf-8")
    settings_A = [
        np.array(pair) * level
        for pair in product((-1.0, 0.0, 1.0), repeat=2)
        for level in LEVELS_A
        if any(pair)
    ]
    rows = []
    for currents_A in settings_A:
        at_m = rng.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, (places, 3))
        field_T = truth.field_T(currents_A, at_m) + NOISE_T * rng.standard_normal((places, 3))
        rows += [
            [*currents_A, *place, 0.0, 0.0, 0.0, *reading]
            for place, reading in zip(at_m, field_T, strict=True)
        ]
    with (folder / "readings.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        currents = [f"{coil}_current_A" for coil in NAMES]
        writer.writerow(["t_s", "sensor", *currents, *(f"mapper_{k}" for k in POSE), "Bx_T", "By_T", "Bz_T"])
        for i, k in enumerate(rng.permutation(len(rows))):
            writer.writerow([2.0 * i, "probe", *rows[k]])
