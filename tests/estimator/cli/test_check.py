"""`coilcal check`: all mistakes at once with their places, and what was understood where there is none."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.port_settings import PortSettings
from estimator.model.unit_gate import check_units
from estimator.model.unlikely_motion import unlikely_motion
from estimator.rig_files.numbers import Numbers
from estimator.rig_files.read import rig_and_faults
from estimator.rig_files.unlikely import unlikely_lengths
from estimator.store.session import load_session
from tests.estimator.cli.conftest import run


@pytest.mark.usefixtures("in_workspace")
def test_what_is_right_is_told_in_a_few_lines():
    result = run("check", "rig.yaml", "readings.csv")
    assert (result.exit_code, result.stderr) == (0, "")
    lines = [re.sub(r"(?<=\S) +", " ", line) for line in result.stdout.splitlines()]
    assert lines[0] == "rig.yaml: rig 'small'"
    assert "  coil coil1: winding of radius 51 mm, 12 x 3 loops; carried by arm1" in lines
    assert "  free parameters: 3; a fit moves these and keeps all others" in lines
    assert "    coil1.radius_m 51 ± 1, at least 0 mm" in lines
    assert "readings.csv: 36 readings" in lines
    assert "  coil1_current 3 to 3 A" in lines
    assert "  arm1_x -0.04 to 0.04 m" in lines
    assert "  set calibration (27), validation (9)" in lines
    assert lines[-1] == "no mistake found"


def test_mistakes_of_both_files_are_told_at_once(workspace, tmp_path):
    rig, readings = tmp_path / "rig.yaml", tmp_path / "readings.csv"
    text = (workspace / "rig.yaml").read_text(encoding="utf-8")
    for old, new in (("radial_loops: 3", "radial_lops: 3"), ("noise_uT: 5", "noise_uT: -5\n    gian: 1")):
        assert old in text
        text = text.replace(old, new)
    rig.write_text(text, encoding="utf-8")
    rows = (workspace / "readings.csv").read_text(encoding="utf-8").splitlines()
    rows[0] = rows[0].replace("By_T", "By").replace("coil1_current_A", "coil_current_A")
    rows[3] = "three" + rows[3][rows[3].index(",") :]
    rows[4] += ",1"
    readings.write_text("\n".join(rows), encoding="utf-8")
    result = run("check", rig, readings, "--json")
    assert result.exit_code == 2
    faults = json.loads(result.stdout)["faults"]
    columns = rows[0].split(",")
    assert [(Path(fault["file"]).name, fault["line"], fault["column"]) for fault in faults] == [
        ("rig.yaml", 8, 5),
        ("rig.yaml", 17, 5),
        ("rig.yaml", 18, 5),
        ("readings.csv", 1, columns.index("By") + 1),
        ("readings.csv", 4, 1),
        ("readings.csv", 5, None),
    ]
    assert faults[0]["message"] == "coils.coil1.radial_loops is missing; the closest is radial_lops"
    assert faults[2]["message"] == "sensors.hall.gian is not a known key; the closest is gain"
    assert "column 'By' must have a unit; write it into the header, as By [UNIT]" in faults[3]["message"]
    told = run("check", rig, readings)
    assert told.exit_code == 2
    assert f"{rig}, line 17, column 5: sensors.hall.noise_uT must be > 0; received -5\n" in told.stdout
    assert told.stdout.endswith("6 mistakes\n")
    assert "no mistake found" not in told.stdout


DEVICES = """
devices:
  hall: {sensor: lakeshore_460, serial: /dev/ttyUSB0, range_mT: 30000, avrg: 3}
  coil1:
    supply: kepco_bop
    tcp: 192.168.0.3
    compliance_V: twenty
    tolerance_mA: 5
    lowest_A: -5
    higest_A: 5
    slew_A_per_s: 10
    continuous_A: 3
    thermal_time_constant_min: 5
  arm1: {arm: ur4e, host: 192.168.0.4}
  warmth: {thermometer: lakeshore_224, tcp: 192.168.0.5, inputs: {coil1: E}}
"""
OF_DEVICES = [
    (3, "devices.hall: sensor.range_T must be at most 3.0; received 30.0"),
    (3, "devices.hall.avrg is not a known key"),
    (4, "devices.coil1.highest_A must be given once, as highest_A or highest_mA; received nothing"),
    (4, "devices.coil1.port must be given; received nothing"),
    (7, "devices.coil1.compliance_V must hold finite numbers; received 'twenty'"),
    (10, "devices.coil1.higest_A is not a known key; the closest is highest_A"),
    (14, "devices.arm1.arm must be one of ur3, ur5"),
    (15, "devices.warmth: thermometer.inputs.coil1 must be A, B, C1 to C5 or D1 to D5; received E"),
]


@pytest.mark.parametrize("is_own_file", [True, False])
def test_mistakes_in_settings_of_instruments_are_told_at_once_and_none_is_opened(
    workspace, tmp_path, monkeypatch, is_own_file
):
    monkeypatch.setattr(PortSettings, "open", lambda *_: pytest.fail("a port was opened"))
    rig = (workspace / "rig.yaml").read_text(encoding="utf-8")
    before = 0 if is_own_file else len(rig.splitlines())
    paths = [tmp_path / "rig.yaml", *([tmp_path / "devices.yaml"] if is_own_file else [])]
    paths[0].write_text(rig + ("" if is_own_file else DEVICES), encoding="utf-8")
    paths[-1].write_text(DEVICES if is_own_file else rig + DEVICES, encoding="utf-8")
    result = run("check", *paths, "--json")
    assert result.exit_code == 2
    faults = json.loads(result.stdout)["faults"]
    assert [fault["line"] - before for fault in faults] == [line for line, _ in OF_DEVICES]
    for fault, (_, words) in zip(faults, OF_DEVICES, strict=True):
        assert words in fault["message"]
        assert fault["file"] == str(paths[-1])


def test_readings_wait_where_nobody_can_say_what_columns_there_are(workspace, tmp_path):
    text = (workspace / "rig.yaml").read_text(encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(
        text.replace("motion: displacement", "motion: shift"), encoding="utf-8"
    )
    result = run("check", tmp_path / "rig.yaml", workspace / "readings.csv")
    assert (result.exit_code, result.stdout.splitlines()[-1]) == (2, "1 mistake")
    assert "readings.csv was not looked at" in result.stdout


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("coil1_current_A", "0", ["at least one coil must carry current"]),
        ("arm1_x_m", "1e3", ["measured and nominal field must agree", "positions of the movers must be"]),
        ("set", "validation", ["session must hold calibration readings"]),
    ],
)
def test_readings_that_an_import_would_refuse_are_named(workspace, tmp_path, column, value, words):
    header, *rows = (workspace / "readings.csv").read_text(encoding="utf-8").splitlines()
    index = header.split(",").index(column)
    changed = [[*cells[:index], value, *cells[index + 1 :]] for cells in (row.split(",") for row in rows)]
    path = tmp_path / "readings.csv"
    path.write_text("\n".join([header, *map(",".join, changed)]), encoding="utf-8")
    result = run("check", workspace / "rig.yaml", path, "--json")
    imported = run("import", path, "--rig", workspace / "rig.yaml", "--out", tmp_path / "new.zarr")
    assert (result.exit_code, imported.exit_code) == (2, 2)
    faults = json.loads(result.stdout)["faults"]
    assert any(word in faults[0]["message"] for word in words)
    assert imported.stderr == f"coilcal: {faults[0]['message']}\n"


def test_a_block_that_was_pasted_twice_is_told_before_and_after_the_import(workspace, tmp_path):
    header, *rows = (workspace / "readings.csv").read_text(encoding="utf-8").splitlines()
    fields = [header.split(",").index(f"B{axis}_T") for axis in "xyz"]
    for row in range(18, 24):
        cells, copied = rows[row].split(","), rows[row - 11].split(",")
        for field in fields:
            cells[field] = copied[field]
        rows[row] = ",".join(cells)
    path, rig = tmp_path / "readings.csv", workspace / "rig.yaml"
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    words = "Readings are not as they were measured: hall holds the fields of earlier readings, in lines 20 to 25."
    checked = run("check", rig, path)
    assert (checked.exit_code, checked.stdout.splitlines()[-1]) == (
        0,
        "the form is right, the readings are not",
    )
    assert f"  {words}" in checked.stdout.splitlines()
    assert words in run("import", path, "--rig", rig, "--out", tmp_path / "copied.zarr").stdout


def test_readings_that_a_sensor_repeated_while_it_was_moved_are_told(workspace, tmp_path):
    rows = (workspace / "readings.csv").read_text(encoding="utf-8").splitlines()
    header = rows[0].split(",")
    fields = [header.index(f"B{axis}_T") for axis in "xyz"]
    cells = [row.split(",") for row in rows]
    for row in cells[12:21]:
        for column in fields:
            row[column] = cells[11][column]
    path = tmp_path / "frozen.csv"
    path.write_text("\n".join(map(",".join, cells)), encoding="utf-8")
    told = json.loads(run("check", workspace / "rig.yaml", path, "--json").stdout)
    assert told["faults"] == []
    (flag,) = told["flagged"]
    assert (flag["reason"], flag["component"]) == ("held", None)
    assert flag["readings"] == list(range(12, 21))
    words = "repeats the reading before to the last digit while place or current change, in lines 13 to 21"
    assert words in run("check", workspace / "rig.yaml", path).stdout


@pytest.mark.parametrize(
    ("right", "wrong", "words"),
    [
        (
            "radius_mm: {prior: {normal: {mean: 51, sd: 1}}}",
            "radius_m: {prior: {normal: {mean: 51, sd: 1}}}",
            ": 51 m is unlikely, usual are 1 mm to 2 m; if 51 mm is meant, write radius_mm (RIG, line 9).",
        ),
        (
            "wire_radius_mm: 0.98",
            "wire_radius_um: 0.98",
            "wire_radius_um: 0.00098 mm is unlikely, usual are 0.01 mm to 20 mm; if 0.98 mm is meant, write wire_radius_mm",
        ),
        (
            "noise_uT: 5",
            "noise_uT: 5\n    world_from_sensor: {z_m: 50}",
            "z_m: 50 m is unlikely, usual is at most 10 m; if 50 mm is meant, write z_mm",
        ),
    ],
)
def test_a_length_of_another_unit_is_told_with_its_place_and_its_cure(
    right, wrong, words, workspace, tmp_path
):
    rig = tmp_path / "rig.yaml"
    text = (workspace / "rig.yaml").read_text(encoding="utf-8")
    assert right in text
    rig.write_text(text.replace(right, wrong), encoding="utf-8")
    result = run("check", rig)
    assert result.exit_code == 0
    assert words.replace("RIG", str(rig)) in result.stdout
    assert result.stdout.splitlines()[-1] == "the form is right, lengths of the rig file may not be"
    assert len(json.loads(run("check", rig, "--json").stdout)["unlikely"]) == 1


@pytest.mark.usefixtures("in_workspace")
@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (
            1e3,
            "arm1_x_m is -40 m in line 2 and 33 more: movers of laboratories stay within 10 m; they look like mm called m, or um called mm; if so,",
        ),
        (
            1e-3,
            "arm1 moves by 0.08 mm at most: hardly any field changes so near; positions may be in m; if so,",
        ),
    ],
)
def test_positions_of_another_unit_are_told(factor, words):
    session = load_session("session.zarr")
    motion = {"arm1": session.observations.motion["arm1"] * factor}
    wrong = replace(session.observations, motion=motion)
    assert unlikely_motion(session.rig, wrong, "a.csv")[0].startswith(words)
    assert not unlikely_motion(session.rig, session.observations, "a.csv")
    if factor < 1.0:  # positions that are too large are refused where a smaller unit fits them
        assert check_units(session.rig, wrong, "a.csv")[0].startswith(words)


@pytest.mark.parametrize("path", sorted(Path("configs").glob("*.yaml")), ids=lambda path: path.stem)
def test_no_length_of_a_known_rig_is_unlikely(path):
    numbers = Numbers()
    assert rig_and_faults(path, numbers)[1] == []
    assert unlikely_lengths(numbers) == []
