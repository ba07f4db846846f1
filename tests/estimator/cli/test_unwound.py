"""A coil without a winding from a CSV to a predicted field, all by the command line."""

from __future__ import annotations

import numpy as np
import pytest
from click.testing import CliRunner

from estimator.cli.main import main
from estimator.rig_files.read import load_rig
from tests.estimator.calibration.test_unwound import CURRENT_A, NOISE_T, TEXT, hidden_T, in_ball

pytestmark = pytest.mark.whole


def run(*arguments: object) -> str:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.slow  # calibration/test_unwound does it by the API
def test_a_magnet_is_imported_calibrated_predicted_and_diagnosed(tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text(TEXT.replace("degree: 10", "degree: 4"))
    places_m = 0.5 * in_ball(120, 1)
    field_T = CURRENT_A * hidden_T(places_m) + np.random.default_rng(1).normal(0.0, NOISE_T, places_m.shape)
    header = "t_s,c1_current_A,stage_x_m,stage_y_m,stage_z_m,Bx_T,By_T,Bz_T"
    rows = np.column_stack((np.arange(120), np.full(120, CURRENT_A), places_m, field_T))
    np.savetxt(tmp_path / "map.csv", rows, delimiter=",", header=header, comments="")
    session, calibration = tmp_path / "session.zarr", tmp_path / "calibration"
    run("import", tmp_path / "map.csv", "--rig", rig, "--out", session)
    output = run("calibrate", session, "--out", calibration, "--ess", 400)
    assert "c1: readings determine 24 of 24 amplitudes" in output
    assert (calibration / "report.html").stat().st_size > 100_000
    grid = ("--grid", "x_mm=-10:10:3", "--grid", "z_mm=5:5:1")
    run("predict", calibration, *grid, "--current", "c1=1", "--out", tmp_path / "field.csv")
    field = np.genfromtxt(tmp_path / "field.csv", delimiter=",", names=True)
    expected_T = hidden_T(np.stack([field[f"{axis}_m"] for axis in "xyz"], 1))
    for i, axis in enumerate("xyz"):
        assert field[f"B{axis}_T"] == pytest.approx(expected_T[:, i], abs=0.01 * np.abs(expected_T).max())
    run("diagnose", session, "--out", tmp_path / "diagnosis", "--most-causes", 1, "--no-posterior")
    assert (tmp_path / "diagnosis" / "report.html").is_file()
    assert load_rig(tmp_path / "diagnosis" / "rig_extended.yaml").unwound[0].name == "c1"
