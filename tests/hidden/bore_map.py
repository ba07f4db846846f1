"""What maps of a bore share: a rig file whose mapper is a little off, and readings of the probes on it."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.hidden.coil import Winding
from tests.hidden.protocols import Array

MAPPER = """
schema_version: 1
name: map of a bore
movers:
  mapper:
    motion: pose
    world_from_base:
      x_mm: {prior: {normal: {mean: 0, sd: 2}}}
      y_mm: {prior: {normal: {mean: 0, sd: 2}}}
      z_mm: {prior: {normal: {mean: 0, sd: 2}}}
"""
NOISE = "{prior: {log_normal: {median: 2, relative_sd: 0.5}}}"
SOLENOID = Winding(radius_m=0.1, wire_radius_m=1e-3, axial_loops=20, radial_loops=6)
SOLENOID_TEXT = """
coils:
  solenoid:
    radius_mm: {prior: {normal: {mean: 100, sd: 0.5}}}
    wire_radius_mm: {prior: {normal: {mean: 1, sd: 0.005}}}
    axial_loops: 20
    radial_loops: 6
    current_gain: {prior: {normal: {mean: 1, sd: 0.005}}}
"""
NOISE_T = 2e-6
POSE = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")


def places_m(n: int, low_m: float, high_m: float, within_m: float, rng: np.random.Generator) -> Array:
    """Drawn evenly over a piece of the bore about the z axis."""
    height_m = rng.uniform(low_m, high_m, n)
    beside_m, turn = within_m * np.sqrt(rng.random(n)), rng.uniform(0.0, 2.0 * np.pi, n)
    return np.column_stack((beside_m * np.cos(turn), beside_m * np.sin(turn), height_m))


def write_map(
    folder: Path,
    coils: str,
    current_A: dict[str, Array],
    at_m: Array,
    field_T: Array,
    rng: np.random.Generator,
    probe: Sequence[str] = (),
    arms_mm: dict[str, tuple[float, float]] | None = None,
) -> None:
    """The rig file and the readings, with noise.

    Args:
        folder: Holds both afterwards.
        coils: The `coils` section of the rig file.
        current_A: By coil.
        at_m, field_T: Where the mapper stands and what is read there; reading by xyz.
        rng: Of the noise.
        probe: Of each reading; by default there is one, on the mapper's axis.
        arms_mm: x and y of each probe on the mapper.
    """
    probe = probe or ["probe"] * len(at_m)
    noisy_T = field_T + NOISE_T * rng.standard_normal(field_T.shape)
    sensors = "".join(
        f"  {name}: {{carried_by: mapper, noise_uT: {NOISE}, flange_from_sensor: {{x_mm: {x}, y_mm: {y}}}}}\n"
        for name, (x, y) in (arms_mm or {"probe": (0.0, 0.0)}).items()
    )
    (folder / "rig.yaml").write_text(f"{MAPPER}sensors:\n{sensors}{coils}", encoding="utf-8")
    with (folder / "readings.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        currents = [f"{coil}_current_A" for coil in current_A]
        writer.writerow(["t_s", "sensor", *currents, *(f"mapper_{k}" for k in POSE), "Bx_T", "By_T", "Bz_T"])
        for i, given_A in enumerate(zip(*current_A.values(), strict=True)):
            writer.writerow([2.0 * i, probe[i], *given_A, *at_m[i], 0.0, 0.0, 0.0, *noisy_T[i]])
