"""The rig that `coilcal init` writes for a sensor on a stage has twenty free numbers; its first calibration samples in seconds."""

from __future__ import annotations

import pytest

from estimator import calibrate
from estimator.inference.ensemble import SamplerSettings
from estimator.model.simulate import simulate
from estimator.readings.plan import plan_from_text
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.starter import Moved, Starter, starter_plan_text, starter_rig_text
from estimator.store.session import Session

pytestmark = pytest.mark.whole


def test_the_sampler_of_a_starter_rig_converges_in_few_steps():
    """With half as many draws to fit the proposal to, 20,000 steps were too few for the ridge of turns, gain and place."""
    answers = Starter(moved=Moved.SENSOR, distance_mm=20.0, noise_uT=15.0)
    rig = rig_from_text(starter_rig_text(answers))
    observations = simulate(rig, plan_from_text(starter_plan_text(answers), rig), {}, seed=5)
    calibration = calibrate(
        Session(rig, observations, "starter"), seed=1, settings=SamplerSettings(max_steps=1000)
    )
    assert calibration.summary()["is_converged"]
    assert calibration.summary()["sampling"]["acceptance"] > 0.5
