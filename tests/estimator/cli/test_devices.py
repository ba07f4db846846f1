"""`coilcal devices check` against simulated instruments behind real ports."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from drivers.deadline import Deadline
from drivers.open import open_devices
from drivers.protocols import FlangePose
from drivers.simulated.faults import Fault
from drivers.simulated.rig import SimulatedRig
from drivers.simulated.world import CoilCircuit
from drivers.supplies.scpi import KEPCO_BOP, ScpiSupply
from drivers.transport.serial_port import SerialPort, SerialSettings
from tests.drivers.fields import along_z
from tests.drivers.rig import free_host
from tests.drivers.test_open import ARM, SENSOR, SUPPLY
from tests.estimator.cli.conftest import run

HOME = FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0))


@pytest.fixture(scope="module")
def simulated() -> Iterator[SimulatedRig]:
    section = {
        "hall": SENSOR,
        "coil1": {**SUPPLY, "highest_temperature_C": 80},
        "arm1": ARM,
        "warmth": {"thermometer": "lakeshore_224", "inputs": {"coil1": "A"}},
    }
    circuits = [CoilCircuit(2.0, 0.0)]
    with SimulatedRig(
        section, {"hall": along_z}, circuits=circuits, homes=[HOME], first_host=free_host()
    ) as running:
        yield running


@pytest.fixture
def rig_path(tmp_path: Path, rig_text: str, simulated: SimulatedRig) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text + yaml.safe_dump({"devices": simulated.section}), encoding="utf-8")
    return path


def test_every_device_says_what_it_is_and_reads_a_value(rig_path, simulated):
    before = simulated.world.snapshot()
    result = run("devices", "check", rig_path)
    assert result.exit_code == 0, result.stderr
    lines = {line.split()[0]: line for line in result.stdout.splitlines()}
    assert list(lines) == ["device", "arm1", "coil1", "hall", "warmth"]
    assert "coil1 22." in lines["warmth"]
    assert "LSCI,F71" in lines["hall"]
    assert "mT" in lines["hall"]
    assert "KEPCO" in lines["coil1"]
    assert "0 A" in lines["coil1"]
    assert "300.00, 0.00, 200.00 mm" in lines["arm1"]
    after = simulated.world.snapshot()
    assert (after.currents_A, after.base_from_flange) == (before.currents_A, before.base_from_flange)


def test_a_supply_that_is_found_on_is_left_on(rig_path, simulated):
    port = SerialPort(simulated.section["coil1"]["serial"], SerialSettings(9600))
    supply = ScpiSupply(
        port, dialect=KEPCO_BOP, lowest_A=-5.0, highest_A=5.0, compliance_V=20.0, resolution_A=1e-3
    )
    deadline = Deadline.after(30.0)
    supply.prepare(deadline)
    supply.write_set_point(2.0, deadline)
    supply.switch_output(True, deadline)
    supply.close()
    try:
        result = run("devices", "check", rig_path, "--json")
        assert result.exit_code == 0, result.stderr
        values = {one["device"]: one["value"] for one in json.loads(result.stdout)["devices"]}
        assert values["coil1"] == "2 A"
        assert simulated.world.snapshot().currents_A == (2.0,)
    finally:
        with open_devices({"coil1": {**SUPPLY, "serial": port.name}}) as devices:
            devices.sources["coil1"].output_off(timeout_s=10.0)
    assert simulated.world.snapshot().currents_A == (0.0,)


def test_faults_are_one_sentence_each_and_the_others_still_answer(rig_path, simulated):
    simulated.simulators["hall"].faults.fault = Fault.MUTE
    try:
        result = run("devices", "check", rig_path, "--json", "--timeout", 1.5)
    finally:
        simulated.simulators["hall"].faults.fault = Fault.NONE
    assert result.exit_code == 5
    found = {one["device"]: one for one in json.loads(result.stdout)["devices"]}
    assert [name for name, one in found.items() if one["fault"]] == ["hall"]
    assert found["coil1"]["value"] == "0 A"
    faults = [line for line in result.stderr.splitlines() if line.startswith("coilcal:")]
    assert len(faults) == 1
    assert faults[0].startswith("coilcal: devices.hall: ")


def test_setting_that_the_instrument_refuses_comes_with_file_and_line(tmp_path, rig_text):
    path = tmp_path / "rig.yaml"
    text = "devices:\n  hall:\n    sensor: lakeshore_460\n    range: 30\n    serial: /dev/none\n"
    path.write_text(rig_text + text, encoding="utf-8")
    result = run("devices", "check", path)
    line = len(rig_text.splitlines()) + 2
    assert result.exit_code == 5
    assert (
        f"devices.hall.range_T must be given once, as range_T or range_mT or range_uT or range_G; received nothing ({path}, line {line})"
        in result.stderr
    )


def test_rig_without_devices_is_refused(tmp_path, rig_text):
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text, encoding="utf-8")
    result = run("devices", "check", path)
    assert result.exit_code == 2
    assert "must have a section devices" in result.stderr
