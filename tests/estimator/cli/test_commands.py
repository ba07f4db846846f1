"""From a rig file to a report, as a user calls it: what every command prints and writes."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
import torch

from estimator.calibration.result import Calibration
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent
from estimator.store.session import load_session
from tests.estimator.cli.conftest import refused, run

COMMANDS = ["simulate", "import", "calibrate", "predict", "report"]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_simulate_warns_of_a_hidden_cause_that_changes_no_reading(simulate, tmp_path):
    call = ("--truth", "nominal", "--out")
    result = simulate("--hide", "coil_heating=0.02", *call, tmp_path / "hidden.zarr")
    assert (result.exit_code, result.stderr) == (
        0,
        "coilcal: warning: coil_heating[coil1].loss_per_K = 0.02 changes no reading of this session\n",
    )
    result = simulate("--hide", "axis_gain=0.02", *call, tmp_path / "seen.zarr")
    assert (result.exit_code, result.stderr) == (0, "")


def test_simulate_draws_a_truth_and_writes_session_and_csv(workspace, results):
    printed = json.loads(results["simulate"].stdout)
    assert (results["simulate"].exit_code, results["simulate"].stderr) == (0, "")
    session = load_session(workspace / "simulated.zarr")
    assert printed["readings"] == len(session.observations) == len(rows(workspace / "readings.csv")) == 36
    assert printed["validation"] == int(session.observations.is_validation.sum()) == 9
    assert printed["truth"] == dict(session.truth)
    assert printed["truth"]["coil1.axial_loops"] == 13.0
    assert printed["truth"]["coil1.radius_m"] not in (0.051, 0.048)


def test_the_imported_csv_is_the_simulated_session(workspace, results):
    simulated, imported = load_session(workspace / "simulated.zarr"), load_session(workspace / "session.zarr")
    assert imported.hash == simulated.hash
    assert imported.truth == {}
    assert results["import"].exit_code == 0
    written, undated = results["import"].stdout.splitlines()
    assert written == f"36 readings (9 of them for validation) written to {workspace / 'session.zarr'}"
    assert "--recorded-at" in undated


def test_every_cause_is_explained():
    """From its declaration, so that a new one is explained as well."""
    listed = run("explain")
    assert [line.split()[0] for line in listed.stdout.splitlines()] == list(EFFECTS)
    for name, effect in EFFECTS.items():
        page = run("explain", name).stdout
        assert page.startswith(f"{name} (")
        assert effect.words in page
        assert all(quantity.key in page for quantity in effect.quantities(Extent()))
    told = json.loads(run("explain", "axis_gain[hall]", "--json").stdout)
    assert told["quantities"]["x"] == {"unit": "1", "null": 0.0, "prior": "0 ± 0.01"}
    unknown = run("explain", "iron_plte")
    assert unknown.exit_code == 2
    assert "the closest is iron_plate" in unknown.stderr
    assert "received 'nosuch'; 'coilcal explain' lists them" in run("explain", "nosuch").stderr


def test_import_says_when_the_readings_were_taken(workspace, tmp_path):
    files = ("--rig", workspace / "rig.yaml", "--out", tmp_path / "old.zarr")
    call = ("import", workspace / "readings.csv", *files)
    assert run(*call, "--recorded-at", "2025-03-01T09:30+01:00").exit_code == 0
    assert load_session(tmp_path / "old.zarr").created == "2025-03-01T08:30:00+00:00"
    wrong = run(*call, "--overwrite", "--recorded-at", "yesterday")
    assert wrong.exit_code == 2
    assert "--recorded-at must be a date such as 2026-03-01" in wrong.stderr
    assert load_session(tmp_path / "old.zarr").created.startswith("2025-03-01")


def test_import_keeps_blocks_out_by_share_and_seed(workspace, tmp_path):
    header, *lines = (workspace / "readings.csv").read_text(encoding="utf-8").splitlines()
    whole = tmp_path / "whole.csv"
    whole.write_text("\n".join(line.rpartition(",")[0] for line in (header, *lines)), encoding="utf-8")
    masks = []
    for i, options in enumerate(("0.4", "0.4", "0.4 --seed 1", "0")):
        out = tmp_path / f"{i}.zarr"
        files = ("--rig", workspace / "rig.yaml", "--out", out)
        result = run("import", whole, *files, "--json", "--validation", *options.split())
        masks.append(load_session(out).observations.is_validation)
        printed = json.loads(result.stdout)
        assert printed == {
            "session": str(out),
            "readings": 36,
            "validation": int(masks[-1].sum()),
            "recorded": load_session(out).created,
            "session_hash": load_session(out).hash,
            "flagged": [],
            "warnings": [],
            "columns": None,
        }
    assert torch.equal(masks[0], masks[1])
    assert not torch.equal(masks[0], masks[2])
    assert 0.4 <= masks[0].double().mean() < 0.6
    assert not masks[3].any()


def test_calibrate_writes_summary_posterior_and_report_and_prints_the_summary(workspace, results):
    result = results["calibrate"]
    assert result.exit_code == 0
    assert sorted(path.name for path in (workspace / "calibration").iterdir()) == [
        "chain.zarr",
        "posterior.zarr",
        "report.html",
        "summary.json",
    ]
    summary = json.loads((workspace / "calibration" / "summary.json").read_text(encoding="utf-8"))
    assert json.loads(result.stdout) == summary
    assert summary["is_converged"] is True
    truth = json.loads(results["simulate"].stdout)["truth"]
    for name, value in truth.items():
        found = summary["parameters"][name]
        assert abs(found["median"] - value) <= 4 * found["sd"]
    assert "Calibration of small" in (workspace / "calibration" / "report.html").read_text(encoding="utf-8")


def test_predict_writes_field_and_intervals_of_the_calibration(workspace, results):
    written, grid = results["predict"].stdout.splitlines()
    assert written == f"5 points written to {workspace / 'field.csv'}"
    assert grid == "x -20 to 20 mm in 5 points, 10 mm apart; y 0 mm; z 10 mm"
    table = rows(workspace / "field.csv")
    intervals = [f"B{axis}_{end}_T" for axis in "xyz" for end in ("lower", "upper")]
    assert list(table[0]) == ["x_m", "y_m", "z_m", "Bx_T", "By_T", "Bz_T", *intervals, "inside_winding"]

    def columns(name: str) -> torch.Tensor:
        rows = [[float(row[name.format(axis)]) for axis in "xyz"] for row in table]
        return torch.tensor(rows, dtype=torch.float64)

    points_m, field_T = columns("{}_m"), columns("B{}_T")
    assert points_m.tolist() == [[x, 0.0, 0.01] for x in (-0.02, -0.01, 0.0, 0.01, 0.02)]
    calibration = Calibration.load(workspace / "calibration")
    torch.testing.assert_close(field_T, calibration.field(points_m, {"coil1": 2.0}), rtol=1e-6, atol=1e-15)
    lower, upper = calibration.field_interval(points_m, {"coil1": 2.0})
    for row, low, high in zip(table, lower, upper, strict=True):
        assert float(row["Bz_lower_T"]) == pytest.approx(low[2].item(), rel=1e-6)
        assert float(row["Bz_upper_T"]) == pytest.approx(high[2].item(), rel=1e-6)


def test_what_is_handed_on_of_a_suspect_calibration_says_so(workspace, tmp_path):
    """Its intervals may lie ten of their widths from the truth, and whoever gets them may never have seen its verdict."""
    good, suspect = workspace / "calibration", tmp_path / "suspect"
    calibration = Calibration.load(good)
    quality = {"verdict": "suspect", "reasons": ["halves of the session disagree."], "next": ""}
    replace(calibration, summary_json={**calibration.summary_json, "quality": quality}).save(suspect)
    for folder, is_told in ((good, False), (suspect, True)):
        points = ("--grid", "x_mm=0", "--current", "coil1=1", "--out", tmp_path / f"{folder.name}.csv")
        said = run("predict", folder, *points).stdout
        header = tmp_path / f"{folder.name}.hpp"
        run("export", folder, "--to", "cpp", "--out", header)
        words = "suspect: halves of the session disagree. Intervals hold only if nothing is wrong."
        assert (words in said) is (f"the calibration is {words}" in header.read_text()) is is_told


def test_predict_leaves_cells_empty_inside_the_winding(workspace, tmp_path):
    best = Calibration.load(workspace / "calibration").best
    inside = [
        f"--grid=x_m={best['coil1.radius_m'] - 0.003}:0.08:2",
        f"--grid=z_m={best['coil1.world_from_coil0.z_m'] - 0.01}",
    ]
    result = run(
        "predict", workspace / "calibration", *inside, "--current", "coil1=3", "--out", tmp_path / "f.csv"
    )
    assert "1 lie inside a winding and are empty" in result.stdout
    first, second = rows(tmp_path / "f.csv")
    assert (first["Bz_T"], first["Bx_lower_T"], first["inside_winding"]) == ("", "", "1")
    assert float(second["Bz_T"]) < 0.0
    assert second["inside_winding"] == "0"


def test_predict_takes_motion_and_level(workspace, tmp_path):
    folder, widths = workspace / "calibration", []
    for level in (0.5, 0.95):
        call = f"--grid x_mm=0 --current coil1=3 --motion arm1=0,0,0.01,0,0,0 --level {level} --overwrite"
        result = run("predict", folder, *call.split(), "--out", tmp_path / "f.csv", "--json")
        assert json.loads(result.stdout) == {
            "file": str(tmp_path / "f.csv"),
            "points": 1,
            "inside_winding": 0,
            "caution": "",
            "level": level,
        }
        (row,) = rows(tmp_path / "f.csv")
        widths.append(float(row["Bz_upper_T"]) - float(row["Bz_lower_T"]))
    assert widths[1] > 2 * widths[0]
    at_rest = Calibration.load(folder).field(torch.tensor([[0.0, 0.0, -0.01]]).double(), {"coil1": 3.0})
    assert float(row["Bz_T"]) == pytest.approx(at_rest[0, 2].item(), rel=1e-6)


def test_predict_in_single_precision_and_on_a_device_that_is_not_there(workspace, tmp_path):
    points = ("--grid=x_mm=-20:20:5", "--grid=z_mm=10", "--current=coil1=2")
    call = ("predict", workspace / "calibration", *points)
    run(*call, "--precision", "single", "--out", tmp_path / "f.csv")
    for single, double in zip(rows(tmp_path / "f.csv"), rows(workspace / "field.csv"), strict=True):
        assert single["x_m"] == double["x_m"]
        for key in ("Bz_T", "Bz_lower_T", "Bz_upper_T"):
            assert single[key] != double[key]
            assert float(single[key]) == pytest.approx(float(double[key]), rel=1e-4)
    refused = run(*call, "--device", "xpu:7", "--out", tmp_path / "g.csv")
    assert refused.exit_code == 2
    assert "device must be one that torch can compute on here" in refused.stderr


def test_report_writes_the_page_again(workspace, tmp_path):
    result = run("report", workspace / "calibration", "--out", tmp_path / "page.html", "--json")
    assert json.loads(result.stdout) == {"report": str(tmp_path / "page.html")}
    assert "<html" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_every_command_has_help(command):
    for option in ("--help", "-h"):
        result = run(*command.split(), option)
        assert result.exit_code == 0
        assert result.stdout.startswith("Usage: ")
        assert result.stderr == ""
    if command:
        assert "--json" in result.stdout
        assert "--out" in result.stdout
    else:
        told = " ".join(result.stdout.split())
        assert "Exit codes: 0 done, 2 bad input, 3 damaged file, 4 sampling did not converge, 5 an" in told
        assert "10 a drift was found, 11 a session was rejected" in told
        assert all(name in result.stdout for name in COMMANDS)


def test_the_version_is_that_of_the_package():
    assert version("coilcal") in run("--version").stdout


def test_without_json_the_summary_is_a_table(workspace, tmp_path):
    """And a run that did not converge says so on standard error, with exit code 4 and the way on."""
    limits = ("--walkers", 16, "--max-steps", 20)
    result = run("calibrate", workspace / "session.zarr", *limits, "--out", tmp_path / "c")
    assert result.exit_code == 4
    *_, last = result.stderr.splitlines()
    assert last == (
        "coilcal: sampling did not converge in 20 steps; intervals are provisional (the same command with more --max-steps continues; measuring what is not determined helps more: coilcal docs choose-priors)"
    )
    notes, _, table = result.stdout.partition("\n\n")
    assert notes.startswith(("good: ", "suspect: "))
    assert "The currents changed too little" in notes
    lines = table.splitlines()
    assert lines[0].split() == ["parameter", "median", "90", "%", "credible", "interval", "unit"]
    assert [line.split()[0] for line in lines[1:4]] == [
        "coil1.radius_m",
        "coil1.world_from_coil0.z_m",
        "coil1.axial_loops",
    ]
    assert any(line.startswith("coil1: 13 x 3 loops with probability ") for line in lines)
    assert any(line.startswith("validation: error ") for line in lines)
    assert lines[-1] == f"report: {tmp_path / 'c' / 'report.html'}"
    assert json.loads((tmp_path / "c" / "summary.json").read_text(encoding="utf-8"))["is_converged"] is False


def test_damaged_files_give_exit_code_3(workspace, tmp_path):
    shutil.copytree(workspace / "session.zarr", tmp_path / "session.zarr")
    shutil.copytree(workspace / "calibration", tmp_path / "calibration")
    before = sorted(tmp_path.rglob("*"))
    predict = ["predict", tmp_path / "calibration", "--grid", "x_m=0", "--current", "coil1=1"]
    for store, command in (
        ("session.zarr/field_sensor_T", ["calibrate", tmp_path / "session.zarr", "--out", tmp_path / "new"]),
        ("calibration/posterior.zarr/posterior/coil1.radius_m", ["report", tmp_path / "calibration"]),
        ("calibration/posterior.zarr/posterior/coil1.radius_m", [*predict, "--out", tmp_path / "new.csv"]),
    ):
        chunk = next(path for path in (tmp_path / store / "c").rglob("*") if path.is_file())
        content = chunk.read_bytes()
        chunk.write_bytes(content[:-3] + b"???")
        assert "is damaged" in refused(run(*command), 3)
        chunk.unlink()
        assert "was altered or lost a chunk" in refused(run(*command), 3)
        chunk.write_bytes(content)
    (tmp_path / "calibration" / "summary.json").write_text("{", encoding="utf-8")
    assert "summary.json must be JSON" in refused(run("report", tmp_path / "calibration"), 3)
    assert sorted(tmp_path.rglob("*")) == before


def test_json_is_printed_alone_even_where_colours_are_forced(workspace, tmp_path, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    limits = ["--walkers", 16, "--max-steps", 20]
    result = run("calibrate", workspace / "session.zarr", *limits, "--out", tmp_path / "c", "--json")
    assert result.exit_code == 4
    assert json.loads(result.stdout)["is_converged"] is False
    for stream in (result.stdout_bytes, result.stderr_bytes):
        assert all(byte >= 32 or byte == 10 for byte in stream)
    assert result.stderr.splitlines()[0].startswith("point estimate")
