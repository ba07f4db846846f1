"""The instruments of a rig beside six busy processes: simulators, supplies, arms and sensors all start, and each answers."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.estimator.cli.test_rig_simulator import start
from tests.program import PROGRAM, ROOT

N_BUSY = 6
RIG = """\
schema_version: 1
name: every instrument
movers: {arm1: {motion: UR3e}, arm2: {motion: UR3}}
coils:
  coil1: &coil {carried_by: arm1, radius_mm: {prior: {normal: {mean: 51, sd: 1}}}, wire_radius_mm: 0.49, axial_loops: 40, radial_loops: 20}
  coil2: {<<: *coil, carried_by: arm2}
  coil3: {<<: *coil, world_from_coil: {x_mm: 900}}
sensors: {f71: {}, model460: {}, senis: {}, metrolab: {}}
devices:
  f71: {sensor: lakeshore_f71, range_mT: 350, serial: none, own_temperature: true}
  model460: {sensor: lakeshore_460, range_mT: 30, serial: none}
  senis: {sensor: senis_3mh6, rate_Hz: 100, range_number: 1, full_scale_mT: 100, serial: none}
  metrolab: {sensor: metrolab_thm1176, range_mT: 100, serial: none}
"""
SUPPLIES = {"coil1": ("kepco_bop", -5), "coil2": ("scpi", 0), "coil3": ("korad_ka3005p", 0)}


@pytest.fixture
def rig_path(tmp_path: Path) -> Path:
    rig = yaml.safe_load(RIG)
    del rig["coils"]["coil3"]["carried_by"]
    for sensor in rig["sensors"].values():
        sensor.update(noise_uT=5, world_from_sensor={"z_mm": 500})
    shared = {"compliance_V": 20, "tolerance_mA": 20, "highest_A": 3, "slew_A_per_s": 20, "continuous_A": 3}
    for coil, (kind, lowest_A) in SUPPLIES.items():
        own = {"supply": kind, "lowest_A": lowest_A, "thermal_time_constant_min": 5, "serial": "none"}
        rig["devices"][coil] = {**shared, **own}
    for arm, kind in (("arm1", "ur3e"), ("arm2", "ur3")):
        reach = {"workspace_low_mm": [-500, -500, 0], "workspace_high_mm": [500, 500, 600]}
        rig["devices"][arm] = {"arm": kind, "host": "none", "highest_speed_mm_per_s": 100, **reach}
    inputs = {coil: f"C{i}" for i, coil in enumerate(SUPPLIES, start=1)}
    rig["devices"]["warmth"] = {"thermometer": "lakeshore_224", "inputs": inputs, "serial": "none"}
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(rig), encoding="utf-8")
    return path


@pytest.fixture
def busy() -> Iterator[None]:
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(N_BUSY)]
    yield
    for hog in hogs:
        hog.kill()
        hog.wait()


@pytest.mark.slow
@pytest.mark.usefixtures("busy")
def test_every_instrument_starts_and_answers_beside_six_busy_processes(rig_path):
    simulator = start(rig_path, devices := rig_path.with_name("devices.yaml"))
    try:
        call = [*PROGRAM, "devices", "check", str(rig_path), "--devices", str(devices), "--json"]
        check = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    finally:
        simulator.terminate()
        simulator.communicate()
    assert check.returncode == 0, check.stderr
    answers = {one["device"]: one["value"] for one in json.loads(check.stdout)["devices"]}
    assert len(answers) == 10
    assert all(answers.values())
