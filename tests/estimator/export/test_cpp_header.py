"""The C++ header, compiled by gcc with warnings as errors, against the calibration that it came from."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.system.actuation import independent_entries
from tests.estimator.export.compared import assert_close, by_gcc, needs_gcc

pytestmark = needs_gcc
PROGRAM = """
#include "magnet.hpp"
#include <cstdio>
using namespace coilcal_three_coils_two_movers;
int main() {
  Magnet magnet;
  Motion motion;
  for (int mover = 0; mover < n_movers; ++mover) {
    for (double& number : motion)
      if (std::scanf("%lf", &number) != 1) return 1;
    magnet.move(mover, motion);
  }
  Currents currents_A;
  for (double& current_A : currents_A)
    if (std::scanf("%lf", &current_A) != 1) return 1;
  Vector p;
  while (std::scanf("%lf %lf %lf", &p[0], &p[1], &p[2]) == 3) {
    const FieldAndGradient at = magnet.field_and_gradient(p, currents_A);
    for (double number : magnet.field_T(p, currents_A)) std::printf("%.17g ", number);
    for (const Vector& row : at.gradient_T_per_m)
      for (double number : row) std::printf("%.17g ", number);
    for (const auto& row : magnet.actuation(p))
      for (double number : row) std::printf("%.17g ", number);
    for (double number : magnet.standard_deviation_T(p, currents_A)) std::printf("%.17g ", number);
    std::printf("\\n");
  }
}
"""

STANDING = """
schema_version: 1
name: standing
coils: {coil: {radius_mm: 50, wire_radius_mm: 0.5, axial_loops: 20, radial_loops: 5, world_from_coil: {z_mm: -30}}}
sensors: {hall: {noise_uT: 5}}
"""
STANDING_PROGRAM = """
#include "magnet.hpp"
#include <cstdio>
int main() {
  coilcal_standing::Magnet magnet;
  try {
    magnet.move(0, {});
    return 1;
  } catch (const std::out_of_range&) {
  }
  std::printf("%.17g ", magnet.field_T({0.0, 0.0, 0.02}, {2.0})[2]);
  std::printf("%.17g", magnet.standard_deviation_T({0.0, 0.0, 0.02}, {2.0})[2]);
}
"""


@pytest.fixture(scope="module")
def rows(
    magnet: Calibration,
    motion: dict[str, Tensor],
    currents_A: dict[str, float],
    points_m: Tensor,
    tmp_path_factory: pytest.TempPathFactory,
) -> np.ndarray:
    """What the compiled program prints for every point."""
    folder: Path = tmp_path_factory.mktemp("cpp")
    magnet.export("cpp", folder / "magnet.hpp")
    numbers = [
        *motion["arm"].tolist(),
        *motion["stage"].tolist(),
        *currents_A.values(),
        *points_m.flatten().tolist(),
    ]
    return by_gcc(folder, PROGRAM, numbers)


def test_field_is_that_of_predict(
    rows: np.ndarray,
    magnet: Calibration,
    motion: dict[str, Tensor],
    currents_A: dict[str, float],
    points_m: Tensor,
) -> None:
    expected_T = magnet.field(points_m, currents_A, motion)
    assert torch.isnan(expected_T).any(1).tolist() == [False] * (len(points_m) - 1) + [True]
    assert_close(rows[:, :3], expected_T)


def test_gradient_is_that_of_predict(
    rows: np.ndarray,
    magnet: Calibration,
    motion: dict[str, Tensor],
    currents_A: dict[str, float],
    points_m: Tensor,
) -> None:
    assert_close(rows[:, 3:12], magnet.gradient(points_m, currents_A, motion))


def test_actuation_times_currents_is_the_field_less_that_without_current(
    rows: np.ndarray,
    magnet: Calibration,
    motion: dict[str, Tensor],
    currents_A: dict[str, float],
    points_m: Tensor,
) -> None:
    matrix = torch.from_numpy(rows[:, 12:36].reshape(-1, 8, 3))
    made = matrix @ torch.tensor(list(currents_A.values())).double()
    field_T = made[:, :3] + magnet.field(points_m, {}, motion)
    assert_close(field_T.numpy(), magnet.field(points_m, currents_A, motion))
    off, on = (independent_entries(magnet.gradient(points_m, each, motion)) for each in ({}, currents_A))
    assert_close((made[:, 3:] + off).numpy(), on)


def test_standard_deviation_is_that_of_the_draws(
    rows: np.ndarray,
    magnet: Calibration,
    motion: dict[str, Tensor],
    currents_A: dict[str, float],
    points_m: Tensor,
) -> None:
    """To first order, and and 400 draws of a narrow posterior hold little of second order; near wires loop counts are no real numbers."""
    room = magnet.room(points_m, motion)
    coordinates = Coordinates(magnet.rig)
    draws = {name: torch.from_numpy(array.ravel()) for name, array in magnet.draws.items()}
    drawn_T = room.field_T(coordinates.values(coordinates.vector(draws)), magnet.currents(currents_A))
    usual = slice(0, 25)
    ratio = rows[usual, 36:] / drawn_T.std(0).numpy()[usual]
    assert np.abs(ratio - 1.0).max() < 0.02
    assert np.isnan(rows[-1, 36:]).all()


def test_header_of_a_coil_that_stands_still_and_is_known_exactly_compiles_too(
    calibrated: Callable[[Rig], Calibration], tmp_path: Path
) -> None:
    """No mover and no direction of the posterior: arrays of length zero."""
    rig = rig_from_text(STANDING)
    calibrated(rig).export("cpp", tmp_path / "magnet.hpp")
    (tmp_path / "main.cpp").write_text(STANDING_PROGRAM, encoding="utf-8")
    strict = ["-std=c++17", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror"]
    subprocess.run(["g++", *strict, "main.cpp", "-o", "main"], cwd=tmp_path, check=True)
    printed = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    expected_T = calibrated(rig).field(torch.tensor([[0.0, 0.0, 0.02]], dtype=torch.float64), {"coil": 2.0})
    assert [float(word) for word in printed.split()] == [
        pytest.approx(expected_T[0, 2].item(), rel=1e-12),
        0.0,
    ]
