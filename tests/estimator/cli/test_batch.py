"""`coilcal batch` from the outside: a page and a table, a sentence for each bad session, and what happens without Dask."""

from __future__ import annotations

import html
import json
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from distributed import LocalCluster

from estimator.cli.batch import batch_command
from estimator.cli.main import main
from estimator.store.importers.readings_csv import write_readings_csv
from estimator.store.session import load_session


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of one whose worker is a thread of this process."""
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as local:
        yield local.scheduler_address


def test_good_sessions_are_calibrated_beside_a_bad_one(small_session, scheduler, tmp_path):
    small_session.save(tmp_path / "good.zarr")
    (tmp_path / "bad.zarr").mkdir()
    out = tmp_path / "out"
    arguments = [str(tmp_path / name) for name in ("good.zarr", "bad.zarr")]
    words = "--posterior none --json --ess 123 --seed 4 --hypothesis plain --hypothesis axis_gain"
    options = ["--out", str(out), *words.split(), "--scheduler", scheduler]
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


def test_without_dask_one_sentence_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "dask", None)
    for name in [name for name in sys.modules if name.startswith("estimator.batching")]:
        monkeypatch.delitem(sys.modules, name)
    result = CliRunner().invoke(main, ["batch", str(tmp_path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert (
        "coilcal batch needs dask: install coilcal with its extra, pip install 'coilcal[batch]'"
        in result.stderr
    )


def test_a_table_is_imported_with_its_recipe_and_calibrated(small_session, rig_text, scheduler, tmp_path):
    small, rig = tmp_path / "small.csv", tmp_path / "rig.yaml"
    rig.write_text(rig_text, encoding="utf-8")
    write_readings_csv(small_session, small)
    other = small.read_text(encoding="utf-8").replace("t_s,", "Zeit,").replace(",", ";").replace(".", ",")
    (tmp_path / "other.csv").write_text(other, encoding="utf-8")
    (tmp_path / "broken.csv").write_text("hello\n", encoding="utf-8")
    names = [column for column in other.splitlines()[0].split(";") if column != "Zeit"]
    recipe = {"schema_version": 1, "columns": {"Zeit": "t_s", **{name: name for name in names}}}
    (tmp_path / "columns.yaml").write_text(
        json.dumps({**recipe, "separator": "semicolons", "decimal": "comma"})
    )

    def failed(*options: str) -> dict[str, str]:
        tables = [str(tmp_path / f"{name}.csv") for name in ("small", "other", "broken")]
        shared = ["--out", str(tmp_path / "out"), "--posterior", "none", "--json"]
        result = CliRunner().invoke(main, ["batch", *tables, *shared, *options])
        assert result.exit_code == 2
        found = json.loads(result.stdout)
        return {Path(path).name: fault for path, fault in found["failed"].items()} | {"fits": found["fits"]}

    nothing = failed()
    assert nothing["fits"] == 0
    assert all("name it with --rig" in nothing[f"{name}.csv"] for name in ("small", "other", "broken"))
    without = failed("--rig", str(rig), "--scheduler", scheduler)
    assert without["fits"] == 1
    assert "--map must say how its columns are read" in without["other.csv"]
    given = failed("--rig", str(rig), "--map", str(tmp_path / "columns.yaml"), "--workers", "1")
    assert set(given) == {"broken.csv", "small.csv", "fits"}
    stored = load_session(tmp_path / "out/sessions/other.zarr")
    assert stored.observations.is_validation.any()
    assert stored.observations.line is not None
