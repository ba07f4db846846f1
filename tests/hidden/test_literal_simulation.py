"""The other way round: nothing is wrong with the readings, the simulation adds spherical components as the paper's eq 13 is printed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from estimator import Rig, diagnose, load_rig
from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.confirmed import answer
from estimator.diagnosis.mixture.naming import fitted_with_stated, named_by
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.readings.plan import load_plan, observations_of
from estimator.rig.rig import Cause
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.session import draw_session
from tests.independent.readings import perfect_readings_T

CONFIGS = Path(__file__).parents[2] / "configs"
TRUTH = json.loads((CONFIGS / "truth/paper_twin.json").read_text(encoding="utf-8"))
SPHERICAL = Cause("spherical_sum", "coil1")


def few_readings_of_nature(rig: Rig) -> Observations:
    """Every second place of the paper's grid, with noise."""
    planned = observations_of(
        load_plan(CONFIGS / "plans/paper_grid.yaml", rig), rig, np.random.default_rng(0)
    )
    few = planned.calibration.rows(torch.arange(0, 125, 2))
    rng = np.random.default_rng(5)
    field_T = perfect_readings_T(TRUTH, few.motion["arm1"][:, :3].numpy(), current_A=3.0)
    return few.with_field(torch.from_numpy(field_T + 1e-4 * rng.normal(size=field_T.shape)))


def test_the_simulations_own_mistake_is_named_and_taken_back():
    rig = load_rig(CONFIGS / "paper_twin.yaml")
    readings = few_readings_of_nature(rig)
    literal = fit_rig(rig, readings, {}, MeasurementModel.build(rig, readings).rules)
    found = answer(literal, Limits(), seed=1)
    assert [named.cause for named in named_by(found)] == [SPHERICAL]
    final = fitted_with_stated(found)
    assert final.rig.effects == (SPHERICAL,)
    weight = "spherical_sum[coil1].weight"
    assert float(final.values[weight]) == pytest.approx(-1.0, abs=2.5 * final.value_sd(weight))
    before_m, after_m = (
        float(fit.values["coil1.radius_m"]) - TRUTH["coil1.radius_m"] for fit in (literal, final)
    )
    assert before_m > 2e-3
    assert abs(after_m) < 1e-3


def test_a_mistake_of_the_record_that_only_bent_the_literal_simulation_is_taken_back(tmp_path):
    """A short coil in other units hides what eq 13 does; beside spherical_sum the record needs no mistake."""
    draw_session(801).write(tmp_path)
    text = (tmp_path / "rig.yaml").read_text(encoding="utf-8")
    literal = text.replace("carried_by: arm1\n", "carried_by: arm1\n    field_sum: spherical_components\n", 1)
    (tmp_path / "rig.yaml").write_text(literal, encoding="utf-8")
    found = diagnose(read_readings_csv(tmp_path / "readings.csv", load_rig(tmp_path / "rig.yaml")), seed=801)
    assert found.record_mistakes == ()
    assert [one.cause for one in found.causes] == [SPHERICAL]
