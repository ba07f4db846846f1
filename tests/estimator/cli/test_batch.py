"""`coilcal batch` from the outside: a page and a table, a sentence for each bad session, and what happens without Dask."""

from __future__ import annotations

import html
import json
import re
import shlex
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from distributed import LocalCluster

from estimator.cli.batch import batch_command
from estimator.cli.main import main
from estimator.store.session import Session


def test_good_sessions_are_calibrated_beside_a_bad_one(small_session: Session, tmp_path: Path):
    small_session.save(tmp_path / "good.zarr")
    (tmp_path / "bad.zarr").mkdir()
    out = tmp_path / "out"
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as local:
        arguments = [str(tmp_path / name) for name in ("good.zarr", "bad.zarr")]
        options = [
            "--out",
            str(out),
            "--posterior",
            "none",
            "--json",
            "--ess",
            "123",
            "--seed",
            "4",
            "--hypothesis",
            "plain",
            "--hypothesis",
            "axis_gain",
            "--scheduler",
            local.scheduler_address,
        ]
        result = CliRunner().invoke(main, ["batch", *arguments, *options])
        options.remove("--json")
        again = CliRunner().invoke(main, ["batch", *arguments, *options])
    assert result.exit_code == again.exit_code == 2
    found = json.loads(result.stdout)
    assert (found["fits"], found["sampled"], found["new"]) == (2, 0, 2)
    assert "2 fits, 0 of them sampled; all there before, nothing was left to do" in again.stdout
    assert list(found["failed"]) == [str(tmp_path / "bad.zarr")]
    assert "bad.zarr: session must be a folder" in result.stderr
    assert (
        (out / "summary.csv").read_text().startswith("job,session,coil,hypothesis,log_evidence,probability")
    )
    page = (out / "overview.html").read_text()
    assert "2 fits, 0 of them sampled, 1 failed" in page
    command = html.unescape(re.search(r"coilcal batch [^<]*", page)[0])
    asked = batch_command.make_context("batch", shlex.split(command)[2:]).params
    assert [str(path) for path in asked["sessions"]] == arguments
    assert (asked["out"], asked["posterior"], asked["hypotheses"]) == (out, "none", ("plain", "axis_gain"))
    assert (asked["ess"], asked["seed"]) == (123.0, 4)


def test_without_dask_one_sentence_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setitem(sys.modules, "dask", None)
    for name in [name for name in sys.modules if name.startswith("estimator.batching")]:
        monkeypatch.delitem(sys.modules, name)
    result = CliRunner().invoke(main, ["batch", str(tmp_path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert (
        "coilcal batch needs dask: install coilcal with its extra, pip install 'coilcal[batch]'"
        in result.stderr
    )
