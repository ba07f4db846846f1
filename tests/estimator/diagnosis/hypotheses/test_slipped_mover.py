"""A mover that lost steps is told from sensors that were bumped at the same instant, in one race."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.hypotheses.candidates import candidates, causes_of
from estimator.diagnosis.hypotheses.screening import screening
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text
from tests.estimator.diagnosis.small_fits import fit_of, predicted_T, with_wrong

RIG = """
schema_version: 1
name: two sensors
movers:
  arm: {motion: displacement}
coils:
  coil:
    carried_by: arm
    radius_mm: {prior: {normal: {mean: 40, sd: 1}}}
    wire_radius_mm: 0.5
    axial_loops: 20
    radial_loops: 10
    world_from_coil0: {z_mm: -45}
sensors:
  front: {noise_uT: 5}
  side: {noise_uT: 5, world_from_sensor: {y_mm: 15, rx_deg: 90}}
"""
SHIFT_M = {"x_m": 3e-4, "y_m": -2e-4, "z_m": 4e-4}
SHIFTED = (Cause("mover_slipped", "arm"), Cause("sensor_bumped", "front"), Cause("sensor_bumped", "side"))
N, CURRENT_A = 60, 6.0


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(RIG)


@pytest.fixture(scope="module")
def readings(rig: Rig) -> Observations:
    random = torch.Generator().manual_seed(5)
    motion = torch.zeros(N, 6, dtype=torch.float64)
    motion[:, :3] = 0.03 * (torch.rand(N, 3, generator=random, dtype=torch.float64) - 0.5)
    silent = Observations(
        2.0 * torch.arange(N, dtype=torch.float64),
        torch.arange(N) % 2,
        torch.full((N, 1), CURRENT_A, dtype=torch.float64),
        {"arm": motion},
        torch.full((N, 3), 1e-3, dtype=torch.float64),
        torch.zeros(N, dtype=torch.bool),
        torch.zeros(N, dtype=torch.int64),
        {},
    )
    noise_T = 5e-6 * torch.randn(N, 3, generator=random, dtype=torch.float64)
    return silent.with_field(predicted_T(rig, silent) + noise_T)


@pytest.mark.whole
@pytest.mark.parametrize(
    "truth", [Cause("mover_slipped", "arm"), Cause("sensor_bumped", "side")], ids=lambda cause: cause.name
)
def test_the_same_shift_at_all_sensors_is_the_movers_and_at_one_the_sensors(
    rig: Rig, readings: Observations, truth: Cause
) -> None:
    half_h = float(readings.time_s.mean()) / 3600.0
    fit = fit_of(rig, with_wrong(rig, readings, truth, {**SHIFT_M, "since_h": half_h}))
    screened = screening(fit, candidates(fit, causes_of(rig, fit)))
    evidence = {cause: log_bayes_factor for cause, (log_bayes_factor, _, _) in screened.items()}
    assert max(evidence, key=evidence.__getitem__) == truth
    assert all(evidence[truth] > evidence[other] + 10.0 for other in SHIFTED if other != truth)


def test_it_is_not_asked_where_a_bumped_sensor_does_the_same(rig: Rig, readings: Observations) -> None:
    one = readings.rows(readings.sensor == 0).alone
    slipped = EFFECTS["mover_slipped"]
    assert slipped.concerns(Circumstances(rig, readings), "arm")
    assert not slipped.concerns(Circumstances(rig, one), "arm")
