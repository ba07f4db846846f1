"""`coilcal plan` as a user calls it: a plan that other commands read as it is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from estimator.cli.simulated_devices import default_devices
from estimator.readings.plan import load_plan
from estimator.rig_files.read import load_rig
from tests.estimator.cli.conftest import refused, run

GOAL = "field 1 % in box x_mm=-20:20 y_mm=-20:20 z_mm=-10:10"


@pytest.fixture(scope="module")
def devices(workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Instruments that are described and not there."""
    section = default_devices(load_rig(workspace / "rig.yaml"))
    ports = {
        name: {**each, "host" if "arm" in each else "serial": "127.0.0.9"} for name, each in section.items()
    }
    ports["coil1"]["continuous_A"] = 2
    path = tmp_path_factory.mktemp("devices") / "devices.yaml"
    path.write_text(yaml.safe_dump({"devices": ports}))
    return path


def test_a_plan_is_acquired_and_simulated_as_it_is(workspace, devices, tmp_path):
    out = tmp_path / "plan.yaml"
    rig = workspace / "rig.yaml"
    result = run("plan", rig, "--devices", devices, "--goal", GOAL, "--stops", 20, "--out", out)
    assert result.exit_code == 0, result.stderr
    assert "expected half-width over the wanted one" in result.stdout
    dry = run("acquire", rig, out, "--devices", devices, "--out", tmp_path / "s.zarr", "--dry-run", "--json")
    stops = json.loads(dry.stdout)["stops"]
    assert len(stops) == 20
    assert {abs(stop["current_A"]["coil1"]) for stop in stops} == {0.0, 2.0}  # what the coil bears for ever
    assert any(stop["is_validation"] for stop in stops)
    again = run("simulate", "--rig", rig, "--plan", out, "--out", tmp_path / "s.zarr")
    assert again.exit_code == 0
    assert run("check", rig, out).exit_code == 0
    assert "informs" in out.read_text()


def test_places_of_a_plan_are_those_within_the_limits(workspace, devices, tmp_path):
    rig, out = workspace / "rig.yaml", tmp_path / "chosen.yaml"
    places = tmp_path / "places.yaml"
    text = (workspace / "plan.yaml").read_text()
    places.write_text(text.replace("currents_A: [{coil1: 3}]", "currents_A: [{coil1: 1}, {coil1: 30}]"))
    call = ("plan", rig, places, "--devices", devices, "--stops", 10, "--out", out, "--json")
    assert json.loads(run(*call).stdout)["stops"] == 10
    assert {stop.current_A["coil1"] for stop in load_plan(out, load_rig(rig)).stops} == {1.0}
    places.write_text(text.replace("currents_A: [{coil1: 3}]", "currents_A: [{coil1: 30}]"))
    assert "must be within the limits of the instruments" in refused(run(*call[:-1], "--overwrite"))
