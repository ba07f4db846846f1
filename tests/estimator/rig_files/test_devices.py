"""The devices of a rig: taken as they stand, refused in one sentence, and no part of what identifies the rig."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimator.errors import InvalidInput
from estimator.rig_files.devices import load_devices, without_devices
from estimator.rig_files.read import load_rig, rig_from_text

DEVICES = """\
devices:
  hall: {sensor: lakeshore_f71, tcp: 192.168.0.12, range_mT: 350}
  coil1:
    supply: kepco_bop    # bipolar
    serial: /dev/ttyUSB1
    highest_A: 5
  arm1: {arm: ur3e, host: 192.168.0.10, workspace_low_mm: [0, -300, 0]}
"""

BAD = {
    "of no kind": ("devices:\n  hall: {tcp: x}\n", "devices.hall must be one of sensor, supply, arm, .* received none .*line 19"),
    "of two kinds": ("devices:\n  hall: {sensor: a, arm: b}\n", "devices.hall must be one of .* received sensor and arm"),
    "of nothing in the rig": ("devices:\n  hal: {sensor: a}\n", r"devices.hal must bear the name of one of the rig's sensors \(hall\); received 'hal'"),
    "feeling nothing in the rig": ("devices:\n  warmth: {thermometer: a, inputs: {coil9: A}}\n", r"devices.warmth.inputs.coil9 must be the name of a coil or sensor \(coil1, hall\)"),
    "with a coil's name": ("devices:\n  coil1: {sensor: a}\n", "devices.coil1 must bear the name of one of the rig's sensors"),
    "no mapping": ("devices:\n  hall: f71\n", "devices.hall must hold keys and values; received 'f71'"),
    "a list": ("devices: [hall]\n", "devices must hold keys and values"),
    "named twice": ("devices:\n  hall: {sensor: a}\n  hall: {sensor: b}\n", "devices.hall must be given once"),
}  # fmt: skip


def test_devices_are_taken_as_they_stand(rig_text):
    rig = rig_from_text(rig_text + DEVICES)
    assert list(rig.devices) == ["hall", "coil1", "arm1"]
    assert rig.devices["coil1"] == {"supply": "kepco_bop", "serial": "/dev/ttyUSB1", "highest_A": 5}
    assert rig.devices["arm1"]["workspace_low_mm"] == [0, -300, 0]


def test_rig_without_devices_has_none(small_rig):
    assert small_rig.devices == {}


@pytest.mark.parametrize("case", BAD)
def test_mistakes_are_refused_with_location_rule_and_value(rig_text, case):
    text, message = BAD[case]
    with pytest.raises(InvalidInput, match=message) as caught:
        rig_from_text(rig_text + text, "rig.yaml")
    assert "(rig.yaml, line " in str(caught.value) or "(rig.yaml)" in str(caught.value)


def test_arm_of_another_model_than_the_joints_is_refused(two_coils_text):
    text = two_coils_text + "devices:\n  arm2: {arm: ur3, host: x}\n"
    with pytest.raises(
        InvalidInput, match="devices.arm2.arm must be ur3e, as the joints of arm2 say; received 'ur3'"
    ):
        rig_from_text(text)


def test_devices_do_not_change_what_identifies_rig_and_session(rig_text, small_session):
    plain = rig_from_text(rig_text)
    first, second = (
        rig_from_text(rig_text + text) for text in (DEVICES, DEVICES.replace("ttyUSB1", "ttyUSB7"))
    )
    assert plain.hash == first.hash == second.hash
    hashes = {replace(small_session, rig=rig).hash for rig in (plain, first, second)}
    assert len(hashes) == 1
    thinner = rig_from_text(rig_text.replace("wire_radius_mm: 0.98", "wire_radius_mm: 0.97") + DEVICES)
    assert replace(small_session, rig=thinner).hash not in hashes


def test_devices_in_the_middle_of_a_file_are_cut_out_alone():
    assert without_devices("a: 1\ndevices:\n  hall: {sensor: x}\nb: 2\n") == "a: 1\nb: 2\n"
    assert without_devices("a: devices\n") == "a: devices\n"


def test_devices_in_a_file_of_their_own(tmp_path, small_rig):
    path = tmp_path / "devices.yaml"
    path.write_text(DEVICES, encoding="utf-8")
    assert load_devices(path, small_rig)["hall"]["range_mT"] == 350
    path.write_text("hall: {}\n", encoding="utf-8")
    with pytest.raises(InvalidInput, match="devices is missing"):
        load_devices(path, small_rig)


def test_rig_file_with_devices_loads(tmp_path, rig_text):
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text + DEVICES, encoding="utf-8")
    assert set(load_rig(path).devices) == {"hall", "coil1", "arm1"}
