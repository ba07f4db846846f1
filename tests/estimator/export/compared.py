"""Numbers of another program beside those of the calibration that it came from."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from torch import Tensor

STRICT = ("-std=c++17", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror")
needs_gcc = pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
needs_octave = pytest.mark.skipif(shutil.which("octave-cli") is None, reason="Octave is not installed")
ROUNDING = 1e-9  # of the field at a point; sums and poses are rounded in another order


def by_gcc(folder: Path, program: str, numbers: Sequence[float]) -> np.ndarray:
    """Rows of numbers that a program prints, compiled without a warning beside a header, given some numbers."""
    (folder / "main.cpp").write_text(program, encoding="utf-8")
    subprocess.run(["g++", *STRICT, "main.cpp", "-o", "main"], cwd=folder, check=True)
    given = " ".join(map(repr, numbers))
    printed = subprocess.run([folder / "main"], input=given, capture_output=True, text=True, check=True)
    return _rows(printed.stdout)


def by_octave(folder: Path, program: str, files: Mapping[str, np.ndarray]) -> np.ndarray:
    """Rows of numbers that a program prints beside a function for MATLAB, given files of numbers."""
    (folder / "main.m").write_text(program, encoding="utf-8")
    for name, values in files.items():
        np.savetxt(folder / f"{name}.txt", values, fmt="%.17g")
    command = ["octave-cli", "--norc", "--no-history", "--quiet", "main.m"]
    printed = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    assert printed.stderr == ""
    return _rows(printed.stdout)


def _rows(printed: str) -> np.ndarray:
    return np.array([[float(word) for word in line.split()] for line in printed.splitlines()])


def assert_close(received: np.ndarray, expected: Tensor) -> None:
    """Equal to rounding relative to the size at each point, NaN at the same points."""
    size = expected.flatten(1).norm(dim=1).numpy()
    error = np.linalg.norm((received - expected.flatten(1).numpy()), axis=1)
    np.testing.assert_array_equal(np.isnan(error), np.isnan(size))
    assert np.nanmax(error / size) < ROUNDING
