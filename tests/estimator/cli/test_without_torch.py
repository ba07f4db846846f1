"""Commands on NumPy: what it lacks, the command does with torch in a second run; a fault of the caller is told once."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.program import PYTHON, finished

ROOT = Path(__file__).parents[3]
CALL = """
import sys
from pathlib import Path
import estimator.numpy_tensors
from estimator.cli.main import main
{without}
try:
    main(prog_name="coilcal")
finally:
    with Path("runs").open("a") as file:
        print("torch" in sys.modules, file=file)
"""


@pytest.mark.parametrize(
    ("without", "current", "exit_code", "runs"),
    [
        ("", "coil1=2", 0, ["False"]),
        ("del estimator.numpy_tensors.linalg", "coil1=2", 0, ["True", "False"]),
        ("del estimator.numpy_tensors.Tensor.norm", "coil1=2", 0, ["True", "False"]),
        ("", "coil9=2", 2, ["False"]),
    ],
)
def test_a_command_runs_again_with_torch_where_numpy_lacks_something(
    workspace, tmp_path, without, current, exit_code, runs
):
    call = [
        "predict",
        workspace / "calibration",
        "--grid",
        "z_mm=10",
        "--current",
        current,
        "--out",
        "field.csv",
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    ran = finished(PYTHON, "-c", CALL.format(without=without), *call, cwd=tmp_path, env=environment)
    assert (ran.returncode, (tmp_path / "runs").read_text().split()) == (exit_code, runs)
    assert (tmp_path / "field.csv").is_file() == (exit_code == 0)
    assert ran.stderr.count("coil9") == (exit_code == 2)
