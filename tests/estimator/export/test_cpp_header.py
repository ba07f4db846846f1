"""The C++ header, compiled by gcc with warnings as errors, against the calibration that it came from."""

from __future__ import annotations

import subprocess

import numpy as np
import pytest
import torch

from estimator.rig_files.read import rig_from_text
from tests.estimator.export.compared import STRICT, needs_gcc

pytestmark = needs_gcc
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


def test_header_has_field_gradient_actuation_and_standard_deviation_of_predict(magnet, question, tmp_path):
    """Near wires loop counts are no real numbers, and deviations not of first order."""
    rows = question.by_gcc(magnet, "three_coils_two_movers", tmp_path)
    question.check(rows, magnet)
    question.check_deviation(rows, magnet, 25)
    assert np.isnan(rows[-1, 36:]).all()


def test_header_of_a_coil_that_stands_still_and_is_known_exactly_compiles_too(calibrated, tmp_path):
    """No mover and no direction of the posterior: arrays of length zero."""
    rig = rig_from_text(STANDING)
    calibrated(rig).export("cpp", tmp_path / "magnet.hpp")
    (tmp_path / "main.cpp").write_text(STANDING_PROGRAM, encoding="utf-8")
    subprocess.run(["g++", *STRICT, "main.cpp", "-o", "main"], cwd=tmp_path, check=True)
    printed = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    expected_T = calibrated(rig).field(torch.tensor([[0.0, 0.0, 0.02]], dtype=torch.float64), {"coil": 2.0})
    assert [float(word) for word in printed.split()] == pytest.approx(
        [float(expected_T[0, 2]), 0.0], rel=1e-12
    )
