"""The other way round: nothing is wrong with the readings, the simulation adds spherical components as the paper's eq 13 is printed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from estimator import Session, diagnose, load_rig
from estimator.config import rig_from_text
from estimator.plan import Plan, load_plan, observations_of
from tests.independent.readings import perfect_readings_T

CONFIGS = Path(__file__).parents[2] / "configs"
PLAN = """
schema_version: 1
name: few places
poses:
  calibration:
    arm1: {x_mm: {from: -50, to: 50, count: 4}, y_mm: {from: -50, to: 50, count: 4}, z_mm: {from: -25, to: 25, count: 3}}
  validation:
    arm1: {x_mm: {from: -40, to: 40, count: 3}, y_mm: {from: -40, to: 40, count: 3}, z_mm: {from: -15, to: 15, count: 2}}
currents_A: [{coil1: 3}]
order: raster
"""


def test_the_simulations_own_mistake_is_named_and_taken_back(tmp_path: Path) -> None:
    rig = load_rig(CONFIGS / "paper_twin.yaml")
    truth = json.loads((CONFIGS / "truth/paper_twin.json").read_text(encoding="utf-8"))
    (tmp_path / "plan.yaml").write_text(PLAN, encoding="utf-8")
    plan: Plan = load_plan(tmp_path / "plan.yaml", rig)
    rng = np.random.default_rng(5)
    planned = observations_of(plan, rig, rng)
    field_T = perfect_readings_T(truth, planned.motion["arm1"][:, :3].numpy(), current_A=3.0)
    readings = planned.with_field(torch.from_numpy(field_T + 1e-4 * rng.normal(size=field_T.shape)))
    found = diagnose(Session(rig, readings, source="nature"), seed=1)

    assert [cause.cause.label for cause in found.causes] == ["spherical_sum[coil1]"]
    weight = found.parameters(found.causes[0].cause)["weight"]
    assert weight["ci90"][0] < -1.0 < weight["ci90"][1]
    inflated_m = float(found.plain.values["coil1.radius_m"]) - truth["coil1.radius_m"]
    restored_m = float(found.extended.values["coil1.radius_m"]) - truth["coil1.radius_m"]
    assert inflated_m > 2e-3
    assert abs(restored_m) < 1e-3
    assert found.gain is not None
    assert found.gain.after.errors.vector_T < 0.5 * found.gain.before.errors.vector_T
    assert rig_from_text(found.extended_rig_text).effects == (found.causes[0].cause,)
