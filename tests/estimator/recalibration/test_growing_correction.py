"""A correction is a field without a name: where it grows from one session to the next, something drifts."""

from __future__ import annotations

import re

import pytest

from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.effects.attach import with_effect
from estimator.inference.ensemble import SamplerSettings
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.recalibration.judgement import judge
from estimator.recalibration.successor import lasting
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.conftest import SIDEWAYS

SETTINGS = SamplerSettings(n_walkers=16, target_ess=400.0, largest_rhat=1.03)


@pytest.fixture(scope="module")
def current(corrected_rig: Rig, small_plan: Plan, small_truth: dict[str, float]) -> Calibration:
    return calibrate(week(corrected_rig, small_plan, small_truth, 5e-6, 1), settings=SETTINGS, seed=1)


def week(rig: Rig, plan: Plan, truth: dict[str, float], sideways_T_per_A: float, seed: int) -> Session:
    readings = simulate(rig, plan, {**truth, SIDEWAYS: sideways_T_per_A}, seed=seed)
    return Session(rig, readings, f"week {seed}")


def test_a_correction_that_grows_is_a_drift(corrected_rig, small_plan, small_truth, current):
    judged = judge(
        week(corrected_rig, small_plan, small_truth, 25e-6, 2),
        corrected_rig,
        current,
        seed=1,
        settings=SETTINGS,
    )
    assert judged.conclusion == "drifted"
    assert "what coil_harmonics[coil1] corrects without a name has changed" in judged.reason
    assert re.search("from 2.[789] µT/A to 14 µT/A rms", judged.reason)  # of three amplitudes, two of them 0
    assert judged.calibration is not None


def test_the_same_correction_agrees(corrected_rig, small_plan, small_truth, current):
    judged = judge(
        week(corrected_rig, small_plan, small_truth, 5e-6, 3),
        corrected_rig,
        current,
        seed=1,
        settings=SETTINGS,
    )
    assert (judged.conclusion, judged.agrees) == ("unchanged", True)


def test_what_one_session_alone_was_corrected_by_does_not_become_part_of_a_version(
    corrected_rig, small_session
):
    """A current that wandered on one day wanders otherwise on the next; a field that goes with the coil stays."""
    wandering = with_effect(
        corrected_rig,
        Cause("current_wanders", "coil1"),
        small_session.observations,
        {"degree2_share": 1e-3, "duration_h": 1.0},
    )
    assert [correction.name for correction in wandering.corrections] == ["coil_harmonics", "current_wanders"]
    kept = lasting(wandering)
    assert kept == corrected_rig
    assert not any(name.startswith("current_wanders") for name in kept.parameters)
