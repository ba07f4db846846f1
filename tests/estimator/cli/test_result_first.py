"""`calibrate` and `diagnose` print their result before they draw a page; with `--json` once all is written."""

from __future__ import annotations

import json
from typing import Any

import click
import pytest

from estimator.cli import calibrate
from estimator.diagnosis import report
from tests.estimator.cli.conftest import run

DRAWN = "pages are drawn now"
FEW = ("--ess", 100, "--walkers", 16)


@pytest.fixture(autouse=True)
def _drawing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def drawn(*_: Any) -> None:
        click.echo(DRAWN)

    monkeypatch.setattr(calibrate, "_write_report", drawn)
    monkeypatch.setattr(report, "write_reports", drawn)


def test_calibrate_prints_its_numbers_before_the_report(workspace, tmp_path):
    result = run("calibrate", workspace / "session.zarr", "--out", tmp_path / "c", *FEW)
    words, drawn, report = result.stdout.partition(DRAWN)
    assert drawn
    assert "90 % credible interval" in words
    assert words.count("coil1.radius_m ") == 1
    assert report == f"\nreport: {tmp_path / 'c' / 'report.html'}\n"


def test_calibrate_prints_json_when_all_is_written(workspace, tmp_path):
    result = run("calibrate", workspace / "session.zarr", "--out", tmp_path / "c", *FEW, "--json")
    words, _, record = result.stdout.partition(DRAWN)
    assert words == ""
    assert json.loads(record) == json.loads((tmp_path / "c" / "summary.json").read_text())


def test_diagnose_prints_its_verdict_before_the_report(workspace, tmp_path):
    limits = ("--most-causes", 0, "--no-posterior")
    result = run("diagnose", workspace / "session.zarr", "--out", tmp_path / "d", *limits)
    words, drawn, written = result.stdout.partition(DRAWN)
    assert drawn
    assert words.startswith("verdict: ")
    assert (
        written.strip()
        == f"written: {', '.join(str(tmp_path / 'd' / name) for name in ('diagnosis.json', 'rig_extended.yaml', 'report.html'))}"
    )
    assert (tmp_path / "d" / "diagnosis.json").is_file()
