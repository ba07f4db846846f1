"""Two coils with iron cores that face each other at an angle, mapped by a sensor at all kinds of currents. The rig file knows of no iron.

Fields come from `iron_cells` and magpylib's loops; nothing is shared with the estimator.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.coil import Winding, blocks_of, circular_field
from tests.hidden.iron_cells import IronRod, field_per_T, polarisations_T
from tests.hidden.protocols import Array

WINDING = Winding(radius_m=0.026, wire_radius_m=0.5e-3, axial_loops=60, radial_loops=12)
NAMES = ("left", "right")
DISTANCE_M, ANGLE_DEG = 0.045, 40.0  # of the front faces from the middle of the map; between the coils' axes
NOISE_T = 20e-6
LEVELS_A = (2.5, 5.0, 7.5)
HALF_WIDTH_M = 0.01  # of the map
POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
RIG = """
schema_version: 1
name: two coils
movers: {mapper: {motion: pose}}
sensors:
  probe: {carried_by: mapper, noise_uT: {prior: {log_normal: {median: 20, relative_sd: 0.3}}}}
coils:
"""
COIL = """
  {name}:
    radius_mm: {{prior: {{normal: {{mean: 26, sd: 0.2}}}}}}
    wire_radius_mm: 0.5
    axial_loops: 60
    radial_loops: 12
    current_gain: {{prior: {{normal: {{mean: 1, sd: 0.005}}}}}}
    world_from_coil:
      x_mm: {{prior: {{normal: {{mean: {x}, sd: 0.5}}}}}}
      y_mm: {{prior: {{normal: {{mean: 0, sd: 0.5}}}}}}
      z_mm: {{prior: {{normal: {{mean: {z}, sd: 0.5}}}}}}
      ry_deg: {ry}
      tilt_x_deg: {{prior: {{normal: {{mean: 0, sd: 0.5}}}}}}
      tilt_y_deg: {{prior: {{normal: {{mean: 0, sd: 0.5}}}}}}
"""


@dataclass(frozen=True)
class Iron:
    """Truth of a core: its sizes, its initial susceptibility, and its polarisation when saturated."""

    radius_m: float = 0.01
    length_m: float = 0.07
    front_m: float = 0.005
    susceptibility: float = 500.0
    saturation_T: float = 1.7

    @property
    def reluctance(self) -> Callable[[Array], Array]:
        """mu0 H over polarisation on Froehlich's curve."""
        return lambda size_T: (
            1.0 / (self.susceptibility * np.clip(1.0 - size_T / self.saturation_T, 1e-3, None))
        )


def settings_A() -> Array:
    """Each coil alone, both, with both signs, at three levels, and none."""
    both = [(a * level, b * level) for a, b in product((-1.0, 0.0, 1.0), repeat=2) for level in LEVELS_A]
    return np.unique(np.array(both) + 0.0, axis=0)


class CoredPair:
    """The truth of the pair.

    Args:
        irons: Of the left and the right core; None where there is none.
        rng: Draws how far the coils stand from where the rig file has them.
        across: Cubes across a core.
    """

    def __init__(
        self, irons: tuple[Iron | None, Iron | None], rng: np.random.Generator, across: int = 6
    ) -> None:
        self.irons, self.across = irons, across
        self.nominal = nominal_poses()
        self.poses = [
            (
                turn * Rotation.from_rotvec(np.deg2rad(0.3) * rng.normal(size=3) * [1, 1, 0]),
                at + 3e-4 * rng.normal(size=3),
            )
            for turn, at in self.nominal
        ]
        self.coil = circular_field(blocks_of(WINDING), nodes=30)

    def field_T(self, currents_A: Array, at_m: Array) -> Array:
        """Flux density in the world, setting by setting, at the same points: setting, point, xyz."""
        total = np.einsum("sc,cpi->spi", currents_A, np.stack([self._of_coil(c, at_m) for c in range(2)]))
        for rod, polarisation in zip(self.rods, self._polarisations_T(currents_A), strict=True):
            total += np.einsum("pwcj,scj->spw", field_per_T(rod, at_m), polarisation)
        return total

    def moments_A_m2(self, currents_A: Array) -> list[Array]:
        """Moment of each core along its axis, by setting."""
        return [
            polarisation[..., 2].sum(1) * rod.edges_m.prod() / (4e-7 * np.pi)
            for rod, polarisation in zip(self.rods, self._polarisations_T(currents_A), strict=True)
        ]

    @property
    def rods(self) -> list[IronRod]:
        """The cores."""
        return [
            IronRod(iron.radius_m, iron.length_m, iron.front_m, self.across, *pose)
            for iron, pose in zip(self.irons, self.poses, strict=True)
            if iron is not None
        ]

    def _polarisations_T(self, currents_A: Array) -> list[Array]:
        rods = self.rods
        if not rods:
            return []
        applied = []
        for rod in rods:
            cells_m = rod.rotation.apply(rod.centres_m) + rod.position_m
            applied.append(
                np.einsum("sc,cpi->spi", currents_A, np.stack([self._of_coil(c, cells_m) for c in range(2)]))
            )
        iron = next(iron for iron in self.irons if iron is not None)
        return polarisations_T(rods, applied, iron.reluctance)

    def _of_coil(self, number: int, at_m: Array) -> Array:
        turn, place_m = self.poses[number]
        return np.asarray(turn.apply(self.coil(turn.inv().apply(at_m - place_m))))


def nominal_poses() -> list[tuple[Rotation, Array]]:
    """Both front faces look at the middle of the map."""
    turns = np.array([90.0, -90.0 - ANGLE_DEG])
    rotations = [Rotation.from_euler("y", turn, degrees=True) for turn in turns]
    return [(rotation, -DISTANCE_M * rotation.apply([0.0, 0.0, 1.0])) for rotation in rotations]


def rig_text() -> str:
    """What the user knows: windings and poses, and nothing of iron."""
    text = RIG
    for name, (rotation, at_m) in zip(NAMES, nominal_poses(), strict=True):
        ry = np.rad2deg(rotation.as_rotvec()[1])
        text += COIL.format(name=name, x=round(1e3 * at_m[0], 6), z=round(1e3 * at_m[2], 6), ry=round(ry, 6))
    return text


def write(
    folder: Path, pair: CoredPair, places: int, rng: np.random.Generator, name: str = "readings.csv"
) -> None:
    """The rig file, and readings at some places for each setting, in random order, with noise."""
    currents_A = settings_A()
    at_m = rng.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, (places * len(currents_A), 3))
    setting = np.repeat(np.arange(len(currents_A)), places)
    field_T = pair.field_T(currents_A, at_m)[setting, np.arange(len(at_m))]
    field_T = field_T + NOISE_T * rng.standard_normal(field_T.shape)
    (folder / "rig.yaml").write_text(rig_text(), encoding="utf-8")
    with (folder / name).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        currents = [f"{coil}_current_A" for coil in NAMES]
        writer.writerow(["t_s", "sensor", *currents, *(f"mapper_{k}" for k in POSE), "Bx_T", "By_T", "Bz_T"])
        for i, k in enumerate(rng.permutation(len(at_m))):
            writer.writerow([2.0 * i, "probe", *currents_A[setting[k]], *at_m[k], 0.0, 0.0, 0.0, *field_T[k]])
