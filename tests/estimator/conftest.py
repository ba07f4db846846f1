"""A rig so small that it is calibrated in a second: one coil on an arm, one sensor, three free parameters."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.inference.ensemble import SamplerSettings
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan, load_plan
from estimator.rig.parameters import Normal
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from tests.once import once

RIG = """\
schema_version: 1
name: small
movers:
  arm1:
    motion: displacement
coils:
  coil1:
    carried_by: arm1
    radius_mm: {prior: {normal: {mean: 51, sd: 1}}}
    wire_radius_mm: 0.98
    axial_loops: {prior: {normal: {mean: 12, sd: 1, lower: 1}}}
    radial_loops: 3
    world_from_coil0:
      z_mm: {prior: {normal: {mean: -40, sd: 3}}}
sensors:
  hall:
    noise_uT: 5
"""

TWO_COILS = """\
schema_version: 1
name: two coils
movers:
  arm1: {motion: displacement}
  arm2: {motion: UR3e, world_from_base: {x_mm: 415, spin_deg: 180}}
coils:
  coil1:
    carried_by: arm1
    radius_mm: {value: 48, prior: {normal: {mean: 50, sd: 3, lower: 40}}}
    wire_radius_mm: 0.49
    axial_loops: {prior: {uniform: {lower: 40, upper: 50}}}
    radial_loops: 22
    world_from_coil0: {z_cm: -4, tilt_x_mrad: {prior: {normal: {mean: 0, sd: 20}}}}
  coil2:
    carried_by: arm2
    radius_mm: {tied_to: coil1.radius_m, factor: 1.5}
    axial_pitch_mm: 1.7
    radial_pitch_um: 1100
    axial_loops: {tied_to: coil1.axial_loops}
    radial_loops: 30
sensors:
  hall:
    noise_G: {prior: {log_normal: {median: 0.2, relative_sd: 0.5}}}
"""

CORRECTION = """
corrections:
  coil_harmonics[coil1]:
    {middle_x_m: 0, middle_y_m: 0, middle_z_m: 0.04, reach_m: 0.06, degree1_cos0_T_per_A: 0, degree1_cos1_T_per_A: 0,
     degree1_sin1_T_per_A: 0}
"""
CORE = """
effects:
  cross_magnetisation[coil1]: {strength: 0.9, radius_m: 0.02, length_m: 0.03, front_m: 0, saturation_T: 2}
"""
AMPLITUDE_WIDTH_T_PER_A = 2e-5
SIDEWAYS = "coil_harmonics[coil1].degree1_cos1_T_per_A"
STRENGTH = "cross_magnetisation[coil1].strength"
CORED_SIZES = {SIDEWAYS: 15e-6, STRENGTH: 0.93}

PLAN = """\
schema_version: 1
name: small grid
poses:
  calibration:
    arm1:
      x_mm: {from: -40, to: 40, count: 3}
      y_mm: {from: -40, to: 40, count: 3}
      z_mm: {from: -20, to: 20, count: 3}
  validation:
    arm1:
      x_mm: {from: -30, to: 30, count: 3}
      y_mm: {from: -30, to: 30, count: 3}
      z_mm: 5
currents_A: [{coil1: 3}]
"""

TRUTH = {"coil1.radius_m": 0.0518, "coil1.axial_loops": 13.0, "coil1.world_from_coil0.z_m": -0.0425}
SETTINGS = SamplerSettings(n_walkers=16, target_ess=400.0, largest_rhat=1.03)


@pytest.fixture(scope="session")
def rig_text() -> str:
    return RIG


@pytest.fixture(scope="session")
def two_coils_text() -> str:
    return TWO_COILS


@pytest.fixture(scope="session")
def plan_text() -> str:
    return PLAN


@pytest.fixture(scope="session")
def small_rig() -> Rig:
    return rig_from_text(RIG, "rig.yaml")


@pytest.fixture(scope="session")
def corrected_rig() -> Rig:
    """The small rig with a uniform field of the coil beside its loops, whose three amplitudes are free."""
    rig = rig_from_text(RIG + CORRECTION)
    amplitudes = [p for p in rig.parameters.values() if p.name.endswith("_T_per_A")]
    prior = Normal(0.0, AMPLITUDE_WIDTH_T_PER_A)
    return rig.with_parameters(replace(amplitude, prior=prior) for amplitude in amplitudes)


@pytest.fixture(scope="session")
def cored_rig() -> Rig:
    """The small rig with an iron core of free strength, and a field across the coil that corrects it, whose amplitude is free."""
    rig = rig_from_text(RIG + CORRECTION + CORE)
    priors = {
        SIDEWAYS: Normal(0.0, AMPLITUDE_WIDTH_T_PER_A),
        STRENGTH: Normal(0.9, 0.05, lower=0.0, upper=1.0),
    }
    return rig.with_parameters(replace(rig.parameters[name], prior=prior) for name, prior in priors.items())


@pytest.fixture(scope="session")
def cored_session(cored_rig: Rig, small_plan: Plan) -> Session:
    readings = simulate(cored_rig, small_plan, {**TRUTH, **CORED_SIZES}, seed=150_201)
    return Session(cored_rig, readings, "simulated")


@pytest.fixture(scope="session")
def cored_calibration(cored_session: Session, tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    settings = SamplerSettings(20, target_ess=200.0, largest_rhat=1.05)
    return once(
        tmp_path_factory,
        "cored_calibration",
        lambda folder: calibrate(cored_session, settings=settings, seed=1),
    )


@pytest.fixture(scope="session")
def small_plan(small_rig: Rig, tmp_path_factory: pytest.TempPathFactory) -> Plan:
    path = tmp_path_factory.mktemp("plan") / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return load_plan(path, small_rig)


@pytest.fixture(scope="session")
def small_truth() -> dict[str, float]:
    return dict(TRUTH)


@pytest.fixture(scope="session")
def small_session(small_rig: Rig, small_plan: Plan) -> Session:
    return Session(small_rig, simulate(small_rig, small_plan, TRUTH, seed=1), "simulated", truth=TRUTH)


@pytest.fixture(scope="session")
def small_settings() -> SamplerSettings:
    return SETTINGS


@pytest.fixture(scope="session")
def small_calibration(small_session: Session, tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    return once(
        tmp_path_factory,
        "small_calibration",
        lambda folder: calibrate(small_session, settings=SETTINGS, seed=1),
    )
