"""Fields on a grid: CSV, and mag_manip's vfield by a reader written from what its own converter does."""

from __future__ import annotations

import csv
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from estimator.errors import InvalidInput
from estimator.export.request import Grid

GRID = Grid(np.linspace(-0.02, 0.02, 3), np.linspace(-0.01, 0.03, 3), np.linspace(0.0, 0.01, 3))


def test_csv_has_field_and_gradient_of_any_model(calibrated, corrected_rig, tmp_path):
    """Corrections too; the column of z runs fastest, and inside the winding cells are empty."""
    model = calibrated(corrected_rig)
    inside = Grid(np.array([0.0, 0.0495]), np.zeros(1), np.array([-0.042, 0.0]))
    path = model.export("csv", tmp_path / "field.csv", grid=inside, currents_A={"coil1": 2.0})
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["z_m"] for row in rows] == ["-0.042", "0.0", "-0.042", "0.0"]
    assert [row["Bx_T"] == "" for row in rows] == [False, False, True, False]
    field_T = model.field(inside.points_m, {"coil1": 2.0})
    gradient = model.gradient(inside.points_m, {"coil1": 2.0})
    for i in (0, 1, 3):
        assert [float(rows[i][f"B{axis}_T"]) for axis in "xyz"] == field_T[i].tolist()
        assert float(rows[i]["dBx_dz_T_per_m"]) == gradient[i, 0, 2].item()


def test_grid_and_currents_are_asked_for(magnet, tmp_path):
    with pytest.raises(InvalidInput, match="export to csv must have a grid"):
        magnet.export("csv", tmp_path / "field.csv", currents_A={"standing": 1.0})
    with pytest.raises(InvalidInput, match="export to csv must have currents"):
        magnet.export("csv", tmp_path / "field.csv", grid=GRID)


def read_vfield(document: dict[str, Any], coil: int, i: int, j: int, k: int) -> list[float]:
    """The converter of mag_manip has x slowest and z fastest."""
    field = document["vfields"][f"coil_{coil}"]
    row: list[float] = field["data"][(i * field["dim_y"] + j) * field["dim_z"] + k]
    return row


def test_vfield_is_the_field_per_ampere(calibrated, magnet, motion, tmp_path):
    quiet = magnet.rig
    for cause in quiet.effects:
        quiet = (
            quiet if cause.name not in ("background_field", "current_offset") else quiet.without_cause(cause)
        )
    model = calibrated(quiet)
    path = model.export("mag_manip", tmp_path / "vfield.yaml", grid=GRID, motion=motion)
    document = yaml.safe_load(path.read_text())
    assert {
        key: document["vfields"]["coil_1"][key] for key in ("dim_x", "dim_y", "dim_z", "min_y", "max_y")
    } == {"dim_x": 3, "dim_y": 3, "dim_z": 3, "min_y": -0.01, "max_y": 0.03}
    point_m = torch.tensor([[GRID.x_m[2], GRID.y_m[1], GRID.z_m[1]]])
    for number, coil in enumerate(quiet.coils):
        field_T = model.field(point_m, {coil.name: 1.0}, motion)
        np.testing.assert_allclose(read_vfield(document, number, 2, 1, 1), field_T[0], rtol=1e-12)


def test_vfield_refuses_what_it_cannot_hold(magnet, motion, tmp_path):
    with pytest.raises(InvalidInput, match="must have a field proportional to the currents"):
        magnet.export("mag_manip", tmp_path / "vfield.yaml", grid=GRID, motion=motion)
    flat = Grid(GRID.x_m, np.zeros(1), GRID.z_m)
    with pytest.raises(InvalidInput, match="as many points along each axis; received 3 x 1 x 3"):
        magnet.export("mag_manip", tmp_path / "vfield.yaml", grid=flat, motion=motion)
    uneven = Grid(GRID.x_m, np.array([0.0, 0.01, 0.03]), GRID.z_m)
    with pytest.raises(InvalidInput, match="evenly spaced points along y; received 3"):
        magnet.export("mag_manip", tmp_path / "vfield.yaml", grid=uneven, motion=motion)
    beside = Grid(np.array([0.05, 0.1]), np.array([0.0, 0.001]), np.array([0.0375, 0.0385]))
    with pytest.raises(InvalidInput, match="must lie outside the windings; 4 of 8 points do not"):
        magnet.export("mag_manip", tmp_path / "vfield.yaml", grid=beside, motion=motion)
