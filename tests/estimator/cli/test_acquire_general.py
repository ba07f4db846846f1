"""`coilcal acquire` beyond the paper: turned poses, joint angles, two arms and two sensors; and plans that `coilcal design` wrote."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch
from click.testing import Result

from estimator.acquisition.pace import stops_of
from estimator.model.simulate import perfect_readings
from estimator.readings.plan import load_plan
from estimator.rig_files.read import load_rig
from estimator.store.session import load_session
from tests.estimator.cli.conftest import run
from tests.estimator.cli.test_rig_simulator import start

RIG = """\
schema_version: 1
name: general motion
movers:
  arm1: {motion: UR3e}
  arm2: {motion: pose, world_from_base: {x_mm: 150, y_mm: -130, z_mm: 230}}
coils:
  coil1: {carried_by: arm1, radius_mm: {prior: {normal: {mean: 51, sd: 1}}}, wire_radius_mm: 0.49, axial_loops: 40, radial_loops: 20}
sensors:
  probe1: {carried_by: arm2, noise_uT: 5}
  probe2: {carried_by: arm2, noise_uT: 5, flange_from_sensor: {x_mm: 40, rz_deg: 90}}
"""
POSTURE = "q0_deg: 0, q1_deg: -90, q2_deg: -90, q3_deg: 0, q4_deg: 90, q5_deg: 0"
TURNED = "q0_deg: 4, q1_deg: -92, q2_deg: -88, q3_deg: 3, q4_deg: 86, q5_deg: 20"
PLAN = f"""\
schema_version: 1
name: turned
settle_s: 0.05
stops:
- {{arm1: {{{POSTURE}}}, arm2: {{x_mm: 250, z_mm: 250}}, current_A: {{coil1: 3}}}}
- {{arm1: {{{POSTURE}}}, arm2: {{x_mm: 250, z_mm: 250, rx_deg: 10, ry_deg: -20, rz_deg: 5}}, current_A: {{coil1: 3}}}}
- {{arm1: {{{TURNED}}}, arm2: {{x_mm: 260, y_mm: 20, z_mm: 240, ry_deg: 25}}, current_A: {{coil1: -2}}}}
- {{arm1: {{{TURNED}}}, arm2: {{x_mm: 240, y_mm: -20, z_mm: 260, rz_deg: 90}}, current_A: {{coil1: 0}}}}
"""
BUSY = re.compile(
    r"arm\d failed: "
)  # by its watchdog, where a busy computer does not kick it five times a second


def measured(rig: Path, plan: Path, out: Path, *hidden: str) -> Result:
    """The plan carried out with a rig that runs for it, again where the computer was too busy for an arm."""
    simulator = start(rig, devices := rig.with_name("devices.yaml"), *hidden, "--seed", "1")
    devices.write_text(devices.read_text().replace("slew_A_per_s: 20", "slew_A_per_s: 100"))
    try:
        for _ in range(4):
            result = run("acquire", rig, plan, "--devices", devices, "--out", out)
            if not BUSY.search(result.stderr):
                break
    finally:
        simulator.terminate()
        simulator.communicate()
    return result


@pytest.mark.slow  # a minute and a half on two busy cores
def test_turned_poses_joint_angles_and_two_sensors_are_what_the_model_says(tmp_path):
    rig_path, plan_path, out = (tmp_path / name for name in ("rig.yaml", "plan.yaml", "session.zarr"))
    rig_path.write_text(RIG, encoding="utf-8")
    plan_path.write_text(PLAN, encoding="utf-8")
    result = measured(rig_path, plan_path, out)
    assert result.exit_code == 0, result.stderr
    session = load_session(out)
    readings, rig = session.observations, load_rig(rig_path)
    assert readings.sensor.tolist() == [0, 1] * 4
    assert bool((readings.time_s.diff()[1::2] > 0.0).all())
    asked = stops_of(load_plan(plan_path, rig), rig, 0)
    for mover in ("arm1", "arm2"):
        reached = readings.motion[mover][::2]
        assert torch.equal(readings.motion[mover][1::2], reached)  # both sensors were read at the same places
        assert float((reached - asked.motion[mover]).abs().max()) < 1e-4
    assert readings.current_A.flatten().tolist() == [3.0, 3.0, 3.0, 3.0, -2.0, -2.0, 0.0, 0.0]
    expected_T = perfect_readings(rig, readings)
    assert float(expected_T[:6].norm(dim=-1).min()) > 4e-4
    difference_T = readings.field_sensor_T - expected_T
    assert float(difference_T.abs().max()) < 5 * 5e-6  # an average of ten has a third of this noise
