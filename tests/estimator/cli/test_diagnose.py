"""`coilcal diagnose` as a user calls it: what it prints and writes, and how it refuses."""

from __future__ import annotations

import csv
import importlib
import json
import math
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from estimator.errors import InvalidInput
from estimator.json_files import read_json
from estimator.rig_files.read import load_rig
from estimator.rig_files.write import rig_text
from estimator.store.session import load_session
from tests.documented import DIAGNOSIS, keys
from tests.estimator.cli.conftest import contents, refused, run

VERDICTS = ("named", "indistinguishable", "unexplained", "nothing_found")
OFFSET_T = 12e-6
RMSE = {"paper_metric_T", "vector_T", "component_T", "max_T", "relative", "angular_deviation_rad"}


@pytest.fixture(scope="module")
def biased(workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The session of the workspace, read with a zero that is off along y by twelve standard errors, of a sensor of unknown noise."""
    folder = tmp_path_factory.mktemp("biased")
    known = "noise_uT: 5"
    text = (workspace / "rig.yaml").read_text(encoding="utf-8")
    assert known in text
    free = "noise_uT: {prior: {log_normal: {median: 5, relative_sd: 0.5}}}"
    (folder / "rig.yaml").write_text(text.replace(known, free), encoding="utf-8")
    with (workspace / "readings.csv").open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    with (folder / "readings.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(table[0]))
        writer.writeheader()
        writer.writerows(row | {"By_T": repr(float(row["By_T"]) + OFFSET_T)} for row in table)
    session = folder / "session.zarr"
    made = run("import", folder / "readings.csv", "--rig", folder / "rig.yaml", "--out", session)
    assert made.exit_code == 0
    return session


@pytest.fixture(scope="module")
def out(biased: Path) -> Path:
    return biased.parent / "diagnosis"


@pytest.fixture(scope="module")
def result(biased: Path, out: Path) -> Result:
    return run("diagnose", biased, "--out", out, "--seed", 3, "--json")


@pytest.fixture(scope="module")
def record(result: Result) -> dict[str, Any]:
    return json.loads(result.stdout)


def test_diagnosis_ends_well_and_tells_its_stages_apart_from_its_result(result, out):
    assert result.exit_code == 0
    lines = result.stderr.splitlines()
    assert len(lines) > 3
    assert all(line.startswith("coilcal: ") for line in lines)
    assert {"diagnosis.json", "rig_extended.yaml"} <= {path.name for path in out.iterdir()}


def test_what_is_printed_is_what_is_written(record, out):
    assert read_json(out / "diagnosis.json") == record


def test_record_holds_the_keys_that_other_scripts_rely_on(record):
    assert set(record) == set(keys(DIAGNOSIS))
    assert record["verdict"] in VERDICTS
    assert record["seed"] == 3
    for judged in (record["gain"]["before"], record["gain"]["after"]):
        assert {*RMSE, "coverage90", "elpd"} <= set(judged)
    for size in record["smallest_visible"].values():
        assert {"size", "unit", "place", "absorbed_by"} <= set(size)


def test_hidden_offset_is_found_with_its_twin(record):
    """One sensor that stands still: the offset may as well be a field of the room."""
    assert record["verdict"] == "indistinguishable"
    (cause,) = record["causes"]
    assert {"name", "place", "probability", "alternatives", "parameters"} <= set(cause)
    names = {cause["name"], *(other["name"] for other in cause["alternatives"])}
    assert {"background_field", "sensor_offset"} <= names
    everything = (
        cause["probability"]
        + cause["p_not_in_library"]
        + sum(other["probability"] for other in cause["alternatives"])
    )
    assert everything == pytest.approx(1.0, abs=1e-6)
    size = cause["parameters"]["y_T"]
    assert set(size) == {"median", "sd", "ci90", "unit", "is_of_prior"}
    assert size["unit"] == "T"
    assert size["median"] == pytest.approx(OFFSET_T, abs=3.0 * size["sd"])
    assert size["sd"] < 0.2 * OFFSET_T
    assert size["ci90"][0] < size["median"] < size["ci90"][1]
    assert any({"background_field", "sensor_offset"} <= set(group) for group in record["indistinguishable"])


def test_extended_rig_takes_the_session(biased, out, record):
    rig = load_rig(out / "rig_extended.yaml")
    assert [cause.name for cause in rig.effects] == [cause["name"] for cause in record["causes"]]
    load_session(biased).check_rig(rig)


def test_clean_session_in_words_names_nothing_and_ends_well(workspace, tmp_path):
    """In single precision, which changes no verdict."""
    before = contents(workspace / "session.zarr")
    single = ("--precision", "single")
    result = run("diagnose", workspace / "session.zarr", *single, "--out", tmp_path / "clean")
    assert result.exit_code == 0
    assert result.stdout.startswith("verdict: nothing_found\n")
    assert str(tmp_path / "clean" / "diagnosis.json") in result.stdout
    assert contents(workspace / "session.zarr") == before
    path = tmp_path / "clean" / "rig_extended.yaml"
    assert load_rig(path) == load_rig(workspace / "rig.yaml")
    assert "#" not in path.read_text(encoding="utf-8")


@pytest.mark.usefixtures("in_workspace")
def test_rig_without_anything_free_is_refused(tmp_path):
    rig = load_rig("rig.yaml")
    (tmp_path / "fixed.yaml").write_text(rig_text(rig.with_fixed(p.name for p in rig.free)), encoding="utf-8")
    result = run("diagnose", "session.zarr", "--rig", tmp_path / "fixed.yaml", "--out", tmp_path / "new")
    assert "must have at least one free parameter" in refused(result)
    assert not (tmp_path / "new").exists()


def test_overwriting_refuses_a_folder_that_is_no_diagnosis_before_it_searches(
    workspace, tmp_path, monkeypatch
):
    def searched(*_: object, **__: object) -> None:
        raise InvalidInput("searched")

    monkeypatch.setattr(importlib.import_module("estimator.diagnosis.diagnose"), "diagnose", searched)
    (tmp_path / "thesis.tex").write_text("years of work", encoding="utf-8")
    result = run("diagnose", workspace / "session.zarr", "--out", tmp_path, "--overwrite")
    assert refused(result) != "searched"
    assert (tmp_path / "thesis.tex").exists()


def test_gain_is_measured_on_readings_kept_out(record: dict[str, Any]):
    before, after = record["gain"]["before"], record["gain"]["after"]
    assert after["vector_T"] < before["vector_T"]
    assert record["elpd_difference"] == pytest.approx(after["elpd"] - before["elpd"])
    assert record["elpd_difference"] > 2.0 * record["elpd_se"] > 0.0
    assert math.isfinite(after["elpd"])
