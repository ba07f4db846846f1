"""Error of the arcs of a racetrack by the number of points along each: Gauss and Legendre beside chords, at some distances.

python -m scripts.benchmarks.arcs
"""

from __future__ import annotations

import magpylib
import numpy as np
import torch

from estimator.field.sided import SidedWinding, distance_to_sided, sided_field_per_ampere
from estimator.field.winding_shape import Rule
from estimator.units import MU0_T_M_PER_A

OURS_OVER_MAGPYLIB = MU0_T_M_PER_A / (4e-7 * np.pi)  # it keeps the mu0 of before 2019
SIDES_M, CORNER_M, PITCH_M = (0.06, 0.04), 0.01, 1e-3


def main() -> None:
    numbers = torch.tensor([*SIDES_M, CORNER_M, 1.0, 1.0, PITCH_M, PITCH_M], dtype=torch.float64)
    winding = SidedWinding(True, *numbers)
    points_m = torch.from_numpy(np.random.default_rng(0).uniform(-0.08, 0.08, (4000, 3)))
    distance_m = distance_to_sided(points_m, winding)
    print("largest error relative to |B| of one racetrack loop, 60 x 40 mm with corners of 10 mm")
    print("distance, mm   per arc   Gauss-Legendre     chords")
    for low, high in ((4e-3, 6e-3), (10e-3, 20e-3), (40e-3, 80e-3)):
        near_m = points_m[(distance_m > low) & (distance_m < high)]
        exact = sided_field_per_ampere(near_m, winding, Rule(1, 1, 400)).numpy()
        for n in (4, 8, 16, 32):
            gauss = sided_field_per_ampere(near_m, winding, Rule(1, 1, n)).numpy()
            chords = by_chords(near_m.numpy(), n)
            errors = (
                np.max(np.linalg.norm(field - exact, axis=1) / np.linalg.norm(exact, axis=1))
                for field in (gauss, chords)
            )
            told = "   ".join(f"{error:12.1e}" for error in errors)
            print(f"{low * 1e3:4.0f} to {high * 1e3:3.0f} {n:9}   {told}")


def by_chords(points_m: np.ndarray, n: int) -> np.ndarray:
    radius_m = CORNER_M + 0.5 * PITCH_M
    corners = []
    for quarter, (right, back) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        for angle in 0.5 * np.pi * (quarter + np.linspace(0.0, 1.0, n + 1)):
            x = right * (0.5 * SIDES_M[0] - CORNER_M) + radius_m * np.cos(angle)
            y = back * (0.5 * SIDES_M[1] - CORNER_M) + radius_m * np.sin(angle)
            corners.append((x, y, -0.5 * PITCH_M))
    loop = magpylib.current.Polyline(current=1.0, vertices=[*corners, corners[0]])
    field: np.ndarray = loop.getB(points_m) * OURS_OVER_MAGPYLIB
    return field


if __name__ == "__main__":
    main()
