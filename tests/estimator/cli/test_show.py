"""`coilcal show`: what each kind of file and folder is, and what it holds."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from estimator.batching.work import RESULT_FILE
from estimator.calibration import files
from estimator.cli import kinds
from estimator.diagnosis.result import CALIBRATION_FOLDER, DIAGNOSIS
from estimator.diagnosis.verdict import UNKNOWN
from estimator.recalibration import registry
from estimator.recalibration.log import Entry
from estimator.recalibration.registry import Registry
from estimator.service.core import DATABASE
from estimator.store.growing import StopReadings, new_header
from estimator.store.importers.readings_csv import FIELD
from estimator.store.journal import Journal
from tests.estimator.cli.conftest import run


def told(path: Path) -> tuple[dict[str, object], list[str]]:
    """Record and lines of a path; neither may be long."""
    words, record = run("show", path), run("show", path, "--json")
    assert (words.exit_code, record.exit_code, words.stderr) == (0, 0, "")
    lines = words.stdout.splitlines()
    assert len(lines) <= 20
    assert lines[0] == f"{path}: {json.loads(record.stdout)['kind']}"
    return json.loads(record.stdout), [line.strip() for line in lines[1:]]


def test_a_session(workspace):
    record, lines = told(workspace / "simulated.zarr")
    assert (record["kind"], record["readings"], record["validation"]) == ("session", 36, 9)
    assert record["is_simulated"] is True
    assert "36 readings, 9 of them for validation, over 35 s" in lines
    assert "current of coil1: 3 to 3 A" in lines
    assert told(workspace / "session.zarr")[0]["is_simulated"] is False


def test_a_calibration(workspace):
    record, lines = told(workspace / "calibration")
    assert record["kind"] == "calibration"
    assert (
        record["parameters"]
        == json.loads((workspace / "calibration" / "summary.json").read_text())["parameters"]
    )
    assert lines[0].startswith("rig 'small'; ")
    assert any("radius" in line and " 90 %: " in line and line.endswith(" mm") for line in lines)


def test_a_damaged_calibration_ends_as_damage_does(workspace, tmp_path):
    shutil.copytree(workspace / "calibration", tmp_path / "calibration")
    summary = tmp_path / "calibration" / "summary.json"
    summary.write_text(summary.read_text().replace("0.0", "0.1", 1))
    assert run("show", tmp_path / "calibration").exit_code == 3
    summary.unlink()
    assert told(tmp_path / "calibration")[0]["kind"] == "unfinished calibration"


def test_files(workspace):
    assert told(workspace / "rig.yaml")[0]["kind"] == "rig file"
    assert told(workspace / "plan.yaml")[1][0] == "plan 'small grid' with poses, currents_A"
    record, _ = told(workspace / "readings.csv")
    assert (record["kind"], record["rows"]) == ("readings CSV", 36)
    record, _ = told(workspace / "field.csv")
    assert (record["kind"], record["points"]) == ("field CSV", 5)


def test_a_session_that_grows(small_rig, tmp_path):
    with Journal.create(tmp_path / "new.zarr", new_header(small_rig, "bench", "plan", {})) as journal:
        stop = StopReadings(0.0, [3.0], {"arm1": [0.0] * 6}, {"hall": [1e-3, 0.0, 0.0]}, False, 0)
        journal.append(stop.entry())
    record, lines = told(tmp_path / "new.zarr")
    assert (record["kind"], record["readings"]) == ("session that grows", 1)
    assert lines[-1].startswith("coilcal acquire writes it")


def test_a_registry(tmp_path):
    (tmp_path / "versions" / "0001").mkdir(parents=True)
    entries = [Entry("updated", "first", taken="2026-01-01", version=1, made=1), Entry("rejected", "bad")]
    (tmp_path / "log.jsonl").write_text("".join(f"{entry.line()}\n" for entry in entries))
    record, lines = told(tmp_path)
    assert (record["kind"], record["versions"], record["last"]) == ("registry", [1], "bad")
    assert lines[:2] == ["1 versions; in use is none", "log: 1 updated, 1 rejected"]
    assert Registry(tmp_path).versions == (1,)


def test_a_diagnosis_and_a_broken_one(tmp_path):
    quantity = {"median": 0.01, "sd": 0.001, "ci90": [0.008, 0.012], "unit": "1"}
    cause = {"name": "axis_gain", "place": "hall", "probability": 0.88, "parameters": {"x": quantity}}
    told_so = {"verdict": "named", "causes": [cause], "next_measurement": [], "ended_early": ""}
    (tmp_path / "diagnosis.json").write_text(json.dumps(told_so))
    assert told(tmp_path)[1][:3] == [
        "verdict: named",
        "axis_gain[hall] (88 %)",
        "x                1.0 % (0.8 to 1.2 %)",
    ]
    difference = {"difference": {"plus": "x", "minus": "z_at_x", **quantity}}
    (tmp_path / "diagnosis.json").write_text(json.dumps(told_so | {"causes": [cause | difference]}))
    assert "known best: x − z at x 1.0 % (0.8 to 1.2 %)" in told(tmp_path)[1]
    others = {"alternatives": [{"name": "backlash"}], "may_be_unknown": True}
    (tmp_path / "diagnosis.json").write_text(json.dumps(told_so | {"causes": [cause | others]}))
    assert "axis_gain[hall] (88 %), or backlash, or something not in the library" in told(tmp_path)[1]
    (tmp_path / "diagnosis.json").write_text('{"verdict": "named"}')
    broken = run("show", tmp_path)
    assert broken.exit_code == 3
    assert "diagnosis must be readable" in broken.stderr


def test_names_that_mark_a_folder_are_those_of_what_writes_it():
    """The command states them by itself: what reads them needs torch, or an extra."""
    assert (kinds.SUMMARY_FILE, kinds.CHAIN_STORE) == (files.SUMMARY_FILE, files.CHAIN_STORE)
    assert (kinds.DIAGNOSIS, kinds.CALIBRATION_FOLDER) == (DIAGNOSIS, CALIBRATION_FOLDER)
    assert (kinds.VERSIONS, kinds.LOG) == (registry.VERSIONS, registry.LOG)
    assert (kinds.RESULT_FILE, kinds.DATABASE) == (RESULT_FILE, DATABASE)
    assert (kinds.UNKNOWN, kinds.FIELD) == (UNKNOWN, FIELD)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "path must exist"),
        (lambda path: path.mkdir(), "path must be something that coilcal reads or writes (session, "),
        (lambda path: path.write_text("hello"), "path must be something that coilcal reads or writes"),
    ],
)
def test_what_is_nothing_of_coilcal_is_refused(tmp_path, make, words):
    make(tmp_path / "thing")
    result = run("show", tmp_path / "thing")
    assert result.exit_code == 2
    assert words in result.stderr
