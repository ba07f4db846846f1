"""`coilcal export` and `coilcal schema calibration`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import jsonschema
import pytest
from click.testing import Result

from tests.estimator.cli.conftest import Run


@pytest.mark.usefixtures("in_workspace")
def test_json_follows_the_schema_that_is_printed(run: Run, tmp_path: Path) -> None:
    out = tmp_path / "new" / "magnet.json"
    result = run("export", "calibration", "--to", "json", "--out", out, "--json")
    assert json.loads(result.stdout) == {"file": str(out), "format": "json"}
    jsonschema.validate(json.loads(out.read_text()), json.loads(run("schema", "calibration").stdout))


def test_file_is_named_after_the_rig_and_not_replaced(
    workspace: Path, run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    monkeypatch.chdir(tmp_path)
    result = run("export", workspace / "calibration", "--to", "cpp")
    assert result.stdout == "C++17 header without dependencies written to coilcal_small.hpp\n"
    text = Path("coilcal_small.hpp").read_text()
    assert "namespace coilcal_small {" in text
    assert "readings about coil1 lay at x " in text
    assert "--overwrite" in refused(run("export", workspace / "calibration", "--to", "cpp"))


@pytest.mark.usefixtures("in_workspace")
def test_bad_grid_is_refused(run: Run, refused: Callable[[Result], str]) -> None:
    bad = run("export", "calibration", "--to", "json", "--grid", "x_mm=1:2")
    assert refused(bad).startswith("--grid must look like x_mm=-50:50:11")
    unused = run("export", "calibration", "--to", "json", "--grid", "x_mm=1")
    assert refused(unused) == "export to json must have no grid, for which it leaves room; received some"
