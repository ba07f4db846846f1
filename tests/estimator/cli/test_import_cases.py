"""Small files that went wrong once: correct units that looked like others, and sensors that stood still, by their lines."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from estimator.store.session import load_session
from tests.estimator.cli.conftest import run

CASES = Path(__file__).parents[2] / "fixtures/unit_gate_and_frozen"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("holder_20mm", ""),
        ("holder_35mm", "Units could not be compared with the rig's nominal model"),
        ("holder_50mm", "Units could not be compared with the rig's nominal model"),
        ("base_frame", "coilcal diagnose looks for the cause"),
    ],
)
def test_correct_units_are_accepted_whatever_else_is_wrong(name, words, tmp_path):
    result = run(
        *("import", CASES / f"{name}.csv", "--rig", CASES / "rig_pose.yaml"),
        *("--out", tmp_path / "session.zarr", "--json"),
    )
    record = json.loads(result.stdout)
    assert (result.exit_code, record["readings"], record["flagged"]) == (0, 16, [])
    assert [words in warning for warning in record["warnings"]] == ([True] if words else [])


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("frozen12_of_48_one_current", range(23, 34)),
        ("frozen48_one_current", range(23, 50)),
        ("frozen54", range(30, 56)),
    ],
)
def test_a_sensor_that_stood_still_is_told_by_the_lines_of_the_file(name, lines, tmp_path):
    path, rig = tmp_path / "readings.csv", CASES / "rig.yaml"
    header, *rows = (CASES / f"{name}.csv").read_text(encoding="utf-8").splitlines()
    # A row in which nothing was measured is no reading, so lines and readings are counted apart.
    gap = ",".join([*rows[0].split(",")[:-3], "", "", ""]).replace("0,", "-9,", 1)
    path.write_text("\n".join([header, gap, *rows]) + "\n", encoding="utf-8")
    first, last = lines[0] + 1, lines[-1] + 1
    told = run("check", rig, path)
    assert f"in lines {first} to {last}." in told.stdout
    record = json.loads(run("check", rig, path, "--json").stdout)["flagged"]
    (flag,) = record
    assert flag["lines"] == list(range(first, last + 1))
    assert flag["readings"] == [line - 2 for line in flag["lines"]]
    run("import", path, "--rig", rig, "--out", tmp_path / "session.zarr")
    session = load_session(tmp_path / "session.zarr")
    assert session.observations.line is not None
    assert session.observations.line.tolist() == list(range(3, len(rows) + 3))
    assert session.observations.validation.line is not None


def test_where_a_reading_stood_is_no_part_of_what_it_is(tmp_path):
    text = (CASES / "holder_20mm.csv").read_text(encoding="utf-8")
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    (tmp_path / "b.csv").write_text("# Monday\n" + text, encoding="utf-8")
    hashes = set()
    for name in ("a", "b"):
        result = run(
            *("import", tmp_path / f"{name}.csv", "--rig", CASES / "rig_pose.yaml", "--yes"),
            *("--out", tmp_path / f"{name}.zarr", "--json"),
        )
        hashes.add(json.loads(result.stdout)["session_hash"])
    assert len(hashes) == 1
