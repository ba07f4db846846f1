"""Calibrations to export: one of a simple coil, and one of a rig that uses everything that formats must express."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from tests.estimator.export.compared import Question

MAGNET = """
schema_version: 1
name: three coils, two movers
movers:
  arm: {motion: UR3e, world_from_base: {x_mm: {value: -415, prior: {normal: {mean: -415, sd: 0.4}}}, y_mm: 131, z_mm: -481}}
  stage: {motion: displacement, displacement_frame: base, base_from_flange0: {rx_deg: 30, rz_deg: 70}}
  idle: {motion: pose}
coils:
  carried:
    carried_by: arm
    radius_mm: {value: 51, prior: {normal: {mean: 51, sd: 0.1}}}
    wire_radius_mm: {value: 0.5, prior: {normal: {mean: 0.5, sd: 0.001}}}
    axial_loops: 30
    radial_loops: {value: 12, prior: {normal: {mean: 12, sd: 0.02}}}
    flange_from_coil: {z_mm: 70, tilt_x_deg: {prior: {normal: {mean: 1, sd: 0.2}}}}
  standing:
    radius_mm: 40
    axial_pitch_mm: {value: 2, prior: {normal: {mean: 2, sd: 0.005}}}
    radial_pitch_mm: 1
    axial_loops: {value: 10, prior: {normal: {mean: 10, sd: 0.02}}}
    radial_loops: 4
    current_gain: {value: 0.9, prior: {normal: {mean: 0.9, sd: 0.002}}}
    world_from_coil: {x_mm: 90, ry_deg: -90, spin_deg: 12}
  shifted:
    carried_by: stage
    radius_mm: 45
    wire_radius_mm: 0.5
    axial_loops: 1
    radial_loops: 8
    world_from_coil0: {y_mm: {value: -80, prior: {normal: {mean: -80, sd: 0.1}}}, rx_deg: -60}
    flange_from_coil: {x_mm: 20, ry_deg: 15, tilt_y_deg: {value: 2, prior: {normal: {mean: 2, sd: 0.1}}}}
sensors: {hall: {noise_uT: 20}}
effects:
  axial_pitch[standing]: {excess: 0.02}
  current_offset[carried]: {offset_A: 0.05}
  neighbour_coil[shifted]: {share: 0.03}
  background_field[room]: {x_T: 2e-5, y_T: {value: -1e-5, prior: {normal: {mean: -1e-5, sd: 1e-6}}}, z_T: 4e-5}
  mount_tilt[shifted]: {x_rad: 0.01, y_rad: -0.02}
"""
JOINTS_RAD = np.deg2rad([0.0, -90.0, -90.0, 0.0, 90.0, 10.0])
MOTION = {
    "arm": torch.from_numpy(JOINTS_RAD),
    "stage": torch.tensor([0.01, -0.02, 0.015, 0.1, -0.3, 0.2]).double(),
}


def calibration_of(rig: Rig, n_draws: int = 400) -> Calibration:
    """A calibration whose best values are the rig's, with draws of its priors, and readings of a sensor at two positions of movers."""
    rng = np.random.default_rng(3)
    draws = {p.name: p.prior.sample(rng, n_draws).reshape(2, -1) for p in rig.free if p.prior}
    motion = {
        mover.name: torch.stack((MOTION.get(mover.name, torch.zeros(6).double()),) * 2)
        for mover in rig.movers
    }
    observations = Observations.of(torch.ones(2, len(rig.coils)).double(), motion, torch.zeros(2, 3).double())
    summary = {"session_hash": "a" * 64, "rig_hash": rig.hash}
    return Calibration(rig, observations, rig.nominal_values(), draws, np.zeros((2, n_draws // 2)), summary)


@pytest.fixture(scope="session")
def calibrated() -> Callable[[Rig], Calibration]:
    return calibration_of


@pytest.fixture(scope="session")
def magnet() -> Calibration:
    return calibration_of(rig_from_text(MAGNET, "magnet.yaml"))


@pytest.fixture(scope="session")
def motion() -> dict[str, Tensor]:
    return MOTION


@pytest.fixture(scope="session")
def currents_A() -> dict[str, float]:
    return {"carried": 3.0, "standing": -2.0, "shifted": 5.0}


@pytest.fixture(scope="session")
def question(points_m: Tensor, currents_A: dict[str, float], motion: dict[str, Tensor]) -> Question:
    return Question(points_m, currents_A, motion)


@pytest.fixture(scope="session")
def points_m() -> Tensor:
    """Points at all distances: in the workspace, far away, on the axis of a coil, beside its wires, and inside them."""
    rng = np.random.default_rng(1)
    random_m = np.concatenate(
        (rng.uniform(-0.03, 0.03, (12, 3)), rng.normal(size=(6, 3)), 40.0 * rng.normal(size=(2, 3)))
    )
    on_axis_m = [[0.02 + 0.01 * i, 0.0, 0.0] for i in range(5)]
    by_wire_m = [[0.09 - 1e-3 * (0.1 + i), 0.0, 0.0385] for i in range(3)] + [[0.0895, 0.01, 0.037]]
    inside_m = [[0.1, 0.0, 0.038]]
    return torch.from_numpy(np.concatenate((random_m, on_axis_m, by_wire_m, inside_m)))
