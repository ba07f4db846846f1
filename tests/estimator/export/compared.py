"""Numbers of another program beside those of the calibration that it came from."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.rig.coordinates import Coordinates
from estimator.system.actuation import independent_entries

STRICT = ("-std=c++17", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror")
needs_gcc = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
needs_octave = pytest.mark.skipif(shutil.which("octave-cli") is None, reason="Octave is not installed")
ROUNDING = 1e-9  # of the field at a point; sums and poses are rounded in another order


CPP = """
#include "magnet.hpp"
#include <cstdio>
using namespace coilcal_NAME;
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
OCTAVE = """
points_m = dlmread("points.txt");
[b, g, a] = magnet(points_m, dlmread("currents.txt"), dlmread("motion.txt"));
n = size(points_m, 1);
printed = [b, reshape(permute(g, [1 3 2]), n, 9), reshape(permute(a, [1 3 2]), n, [])];
MORE
printf([repmat("%.17g ", 1, size(printed, 2)), "\\n"], printed');
"""


class Exported(Protocol):
    """A calibration or a system of them."""

    def export(self, to: str, path: Path) -> Path: ...


@dataclass(frozen=True)
class Question:
    """Points, and currents and poses of movers in the order of an export."""

    points_m: Tensor
    currents_A: Mapping[str, float]
    motion: Mapping[str, Tensor]

    def by_gcc(self, magnet: Exported, name: str, folder: Path) -> np.ndarray:
        """Field, gradient, actuation and standard deviation at each point by the header, compiled without a warning."""
        magnet.export("cpp", folder / "magnet.hpp")
        moved = torch.cat(list(self.motion.values())).tolist()
        numbers = [*moved, *self.currents_A.values(), *self.points_m.flatten().tolist()]
        (folder / "main.cpp").write_text(CPP.replace("NAME", name), encoding="utf-8")
        subprocess.run(["g++", *STRICT, "main.cpp", "-o", "main"], cwd=folder, check=True)
        given = " ".join(map(repr, numbers))
        printed = subprocess.run([folder / "main"], input=given, capture_output=True, text=True, check=True)
        return _rows(printed.stdout)

    def by_octave(self, magnet: Exported, folder: Path, more: str = "") -> np.ndarray:
        """Field, gradient and actuation at each point by the function for MATLAB, and what more is `printed`."""
        magnet.export("matlab", folder / "magnet.m")
        (folder / "main.m").write_text(OCTAVE.replace("MORE", more), encoding="utf-8")
        np.savetxt(folder / "points.txt", self.points_m.numpy(), fmt="%.17g")
        np.savetxt(folder / "currents.txt", [list(self.currents_A.values())], fmt="%.17g")
        np.savetxt(folder / "motion.txt", torch.stack(list(self.motion.values())).numpy(), fmt="%.17g")
        command = ["octave-cli", "--norc", "--no-history", "--quiet", "main.m"]
        printed = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
        assert printed.stderr == ""
        return _rows(printed.stdout)

    def check(self, rows: np.ndarray, magnet: Calibration) -> None:
        """Field, gradient and, where rows have it, actuation are those of predict; the last point lies in a winding."""
        field_T, gradient = (
            ask(self.points_m, self.currents_A, self.motion) for ask in (magnet.field, magnet.gradient)
        )
        assert torch.isnan(field_T).any(1).tolist() == [False] * (len(field_T) - 1) + [True]
        assert_close(rows[:, :3], field_T)
        assert_close(rows[:, 3:12], gradient)
        n = len(self.currents_A)
        if rows.shape[1] < 12 + 8 * n:
            return
        matrix = torch.from_numpy(rows[:, 12 : 12 + 8 * n].reshape(-1, 8, n))
        made = matrix @ torch.tensor(list(self.currents_A.values())).double()
        assert_close((made[:, :3] + magnet.field(self.points_m, {}, self.motion)).numpy(), field_T)
        off = independent_entries(magnet.gradient(self.points_m, {}, self.motion))
        assert_close((made[:, 3:] + off).numpy(), independent_entries(gradient))

    def check_deviation(self, rows: np.ndarray, magnet: Calibration, n: int) -> None:
        """Standard deviations at the first points are those of draws, to first order: of a narrow posterior that is 2 %."""
        coordinates = Coordinates(magnet.rig)
        draws = {name: torch.from_numpy(array.ravel()) for name, array in magnet.draws.items()}
        values = coordinates.values(coordinates.vector(draws))
        drawn_T = magnet.room(self.points_m, self.motion).field_T(values, magnet.currents(self.currents_A))
        assert np.abs(rows[:n, -3:] / drawn_T.std(0).numpy()[:n] - 1.0).max() < 0.02


def _rows(printed: str) -> np.ndarray:
    return np.array([[float(word) for word in line.split()] for line in printed.splitlines()])


def assert_close(received: np.ndarray, expected: Tensor) -> None:
    """Equal to rounding relative to the size at each point, NaN at the same points."""
    size = expected.flatten(1).norm(dim=1).numpy()
    error = np.linalg.norm((received - expected.flatten(1).numpy()), axis=1)
    np.testing.assert_array_equal(np.isnan(error), np.isnan(size))
    assert np.nanmax(error / size) < ROUNDING
