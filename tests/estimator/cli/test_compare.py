"""`coilcal compare` with a map that coilcal exported itself."""

from __future__ import annotations

import json

import pytest

from tests.estimator.cli.conftest import refused, run

GRID = ["--grid", "x_mm=-60:60:25", "--grid", "y_mm=-60:60:25", "--grid", "z_mm=-35:50:18"]


@pytest.mark.usefixtures("in_workspace")
def test_a_map_of_the_calibrated_coil_explains_its_readings(tmp_path):
    """The world frame of the small rig is that of the coil, 40 mm further on; the fit of the pose finds what is left."""
    fem, out = tmp_path / "fem.csv", tmp_path / "comparison"
    run("export", "calibration", "--to", "csv", *GRID, "--current", "coil1=2", "--out", fem)
    lines = fem.read_text().splitlines()
    shifted = [
        lines[0],
        *(
            f"{x},{y},{float(z) + 0.04:.12g},{rest}"
            for x, y, z, rest in (line.split(",", 3) for line in lines[1:])
        ),
    ]
    fem.write_text("\n".join(shifted), encoding="utf-8")
    call = ["compare", "session.zarr", "--map", fem, "--map-current", 2, "--out", out]
    printed = json.loads(run(*call, "--json").stdout)
    assert printed == json.loads((out / "comparison.json").read_text())
    assert printed["explained_by"] == "both"
    assert printed["outside"] == 0
    page = (out / "comparison.html").read_text()
    assert "Both the map and the coil model explain the readings." in page
    assert page.count("data:image/png") == 2
    assert "--overwrite" in refused(run(*call))
    assert refused(run(*call[:-2], "--coil", "coil2", "--out", tmp_path / "other")) == (
        "coil of the map must be one of coil1; received coil2"
    )
    text = run(*call, "--overwrite").stdout
    assert text.startswith("Both the map and the coil model explain the readings.\nThe map predicts")
