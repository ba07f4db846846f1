"""`coilcal export` and `coilcal schema calibration`."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import jsonschema
import pytest
import torch

from estimator.calibration.result import Calibration
from tests.estimator.cli.conftest import refused, run

PAGE = Path(__file__).parents[3] / "docs/how-to/use-a-calibration-elsewhere.md"


@pytest.mark.usefixtures("in_workspace")
def test_json_follows_the_schema_that_is_printed(tmp_path):
    out = tmp_path / "new" / "magnet.json"
    result = run("export", "calibration", "--to", "json", "--out", out, "--json")
    assert json.loads(result.stdout) == {"file": str(out), "format": "json"}
    jsonschema.validate(json.loads(out.read_text()), json.loads(run("schema", "calibration").stdout))


def test_file_is_named_after_the_rig_and_not_replaced(workspace, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run("export", workspace / "calibration", "--to", "cpp")
    assert result.stdout == "C++17 header without dependencies written to coilcal_small.hpp\n"
    text = Path("coilcal_small.hpp").read_text()
    assert "namespace coilcal_small {" in text
    assert "readings about coil1 lay at x " in text
    assert "--overwrite" in refused(run("export", workspace / "calibration", "--to", "cpp"))


def test_coils_alone_exports_the_calibration_without_the_room(workspace, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    whole: list[Calibration] = []
    monkeypatch.setattr(Calibration, "coils_alone", lambda self: whole.append(self) or self)
    for options, n_alone in (((), 0), (("--coils-alone",), 1)):
        run("export", workspace / "calibration", "--to", "json", "--overwrite", *options)
        assert len(whole) == n_alone


def block(language: str) -> str:
    """The first example of a language on the page that explains exports."""
    text = PAGE.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)[0]


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_example_in_cpp_compiles_and_prints_the_field(workspace, tmp_path):
    run("export", workspace / "calibration", "--to", "cpp", "--out", tmp_path / "magnet.hpp")
    (tmp_path / "main.cpp").write_text(block("cpp"), encoding="utf-8")
    strict = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "main.cpp", "-o", "main"]
    subprocess.run(strict, cwd=tmp_path, check=True)
    printed = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    calibration = Calibration.load(workspace / "calibration")
    moved = {"arm1": torch.tensor([0.01, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)}
    field_T = calibration.field(torch.tensor([[0.0, 0.0, 0.02]], dtype=torch.float64), {"coil1": 3.0}, moved)
    assert printed.startswith(f"Bz {field_T[0, 2]:.6g} +- ")


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="Octave is not installed")
def test_example_for_matlab_runs(workspace, tmp_path):
    run("export", workspace / "calibration", "--to", "matlab", "--out", tmp_path / "magnet.m")
    (tmp_path / "main.m").write_text(
        block("matlab") + "\nprintf('%.10g\\n', field_T(1, 3));", encoding="utf-8"
    )
    command = ["octave-cli", "--norc", "--no-history", "--quiet", "main.m"]
    printed = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    calibration = Calibration.load(workspace / "calibration")
    moved = {"arm1": torch.tensor([0.01, 0.0, 0.0, 0.0, 0.0, 0.0], dtype=torch.float64)}
    field_T = calibration.field(torch.tensor([[0.0, 0.0, 0.02]], dtype=torch.float64), {"coil1": 3.0}, moved)
    assert float(printed) == pytest.approx(field_T[0, 2].item(), rel=1e-9)


@pytest.mark.usefixtures("in_workspace")
def test_bad_grid_is_refused():
    bad = run("export", "calibration", "--to", "json", "--grid", "x_mm=1:2")
    assert refused(bad).startswith("--grid must look like x_mm=-50:50:11")
    unused = run("export", "calibration", "--to", "json", "--grid", "x_mm=1")
    assert refused(unused) == "export to json must have no grid, for which it leaves room; received some"
