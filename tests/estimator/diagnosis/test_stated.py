"""What a rig file states and is not so, hidden in rigs on a mapper and on an arm, and diagnosed.

Each is named, alone or in a set with those that geometry makes its twins, and readings kept out of the fits are predicted better.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator import Session, simulate
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.verdict import Verdict
from estimator.frames import Transform
from estimator.geometry.kinematics import base_from_flange
from estimator.geometry.motion import motion_reached
from estimator.readings.plan import Plan
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text

pytestmark = pytest.mark.whole

COIL = """
    radius_mm: {prior: {normal: {mean: 51, sd: 1}}}
    wire_radius_mm: 0.49
    axial_loops: {prior: {normal: {mean: 48, sd: 1, lower: 1}}}
    radial_loops: 25
"""
TIGHT = "{x_mm: PRIOR, y_mm: PRIOR, z_mm: 0}".replace("PRIOR", "{prior: {normal: {mean: 0, sd: 0.05}}}")
NOISE = "noise_uT: {prior: {log_normal: {median: 20, relative_sd: 0.5}}}"
MAPPER = f"""
schema_version: 1
name: a probe on a mapper, before a coil whose place is known
movers: {{arm: {{motion: pose}}}}
coils:
  coil: {{{COIL.strip().replace(chr(10), ",")}, world_from_coil: {TIGHT}}}
sensors:
  hall: {{carried_by: arm, {NOISE}}}
"""
ARM = f"""
schema_version: 1
name: a coil on an arm, before a probe whose place is stated
movers: {{arm: {{motion: UR3e}}}}
coils:
  coil: {{carried_by: arm, {COIL.strip().replace(chr(10), ",")}, flange_from_coil: {{z_mm: 70}}}}
sensors:
  hall: {{{NOISE}, world_from_sensor: {{x_mm: 415, y_mm: -131, z_mm: 481}}}}
"""
FIXED_NOISE = MAPPER.replace(NOISE, "noise_uT: 20")
N_POSES = 40


def plan_of(rig: Rig) -> Plan:
    """Poses that bring the probe anywhere within 30 mm before the coil, turned by up to 25 degrees."""
    rng = np.random.default_rng(7)
    in_coil_m = rng.uniform((-0.03, -0.03, 0.025), (0.03, 0.03, 0.055), (N_POSES, 3))
    turns = Rotation.from_rotvec(np.radians(rng.uniform(-25.0, 25.0, (N_POSES, 3))))
    motion = np.concatenate((in_coil_m, turns.as_rotvec()), axis=1)
    if rig.coils[0].carried_by:
        near = torch.deg2rad(torch.tensor([0.0, -90.0, -90.0, 0.0, 90.0, 0.0], dtype=torch.float64))
        turns = Rotation.from_matrix(base_from_flange("UR3e", near).rotation.numpy()) * turns
        flange_m = np.array([0.415, -0.131, 0.481]) - turns.apply(in_coil_m + np.array([0.0, 0.0, 0.07]))
        flange = Transform.from_pose(torch.from_numpy(flange_m), torch.from_numpy(turns.as_rotvec()))
        motion = motion_reached(rig.movers[0], flange, Transform.identity(), near.expand(N_POSES, 6)).numpy()
    poses = tuple({"arm": row} for row in motion)
    return Plan("random poses", poses, (), ({"coil": 3.0}, {"coil": -2.0}), "raster", 1, 1.0)


def session(rig: Rig, hidden: dict[str, float]) -> Session:
    """Readings with causes that the rig file does not tell of."""
    return Session(rig, simulate(rig, plan_of(rig), {}, 3, hidden), "simulated")


def assert_named(diagnosis: Diagnosis, cause: Cause, twins: set[str]) -> None:
    """One cause is named: the hidden one alone, or one of a set of it and its twins; and unseen readings are predicted better."""
    (named,) = diagnosis.findings.causes
    credible = {each.label for each in (named.cause, *(other.cause for other in named.alternatives))}
    assert cause.label in credible
    assert credible <= {cause.label, *twins}
    assert bool(named.alternatives) is (len(credible) > 1)
    assert diagnosis.verdict is (Verdict.NAMED if named.is_alone else Verdict.INDISTINGUISHABLE)
    improvement = diagnosis.fits.improvement
    assert improvement is not None
    assert improvement.elpd_difference > improvement.elpd_se


@pytest.mark.parametrize(
    ("rig_text", "hidden", "twins"),
    [
        pytest.param(ARM, {"sensor_misplaced[hall].x_m": 2e-3}, {"base_misplaced[arm]"}, id="2 mm"),
        pytest.param(
            ARM,  # 20 standard deviations beyond what the fit can follow
            {
                f"joint_zeros[arm].q{i}_rad": zero_rad
                for i, zero_rad in ((1, 1.34e-3), (2, -2.01e-3), (4, 1.34e-3))
            },
            set(),
            id="zeros",
            marks=pytest.mark.slow,
        ),
        pytest.param(FIXED_NOISE, {"noise_misstated[hall].factor": 1.6}, set(), id="noise"),
    ],
)
def test_number_that_is_stated_wrong_is_named(rig_text, hidden, twins):
    rig = rig_from_text(rig_text)
    diagnosis = diagnose(session(rig, hidden), seed=1)
    name, _, place = next(iter(hidden)).partition(".")[0].removesuffix("]").partition("[")
    assert_named(diagnosis, Cause(name, place), twins)
