"""Axis scans are read in their units, and tables with other columns or without currents are refused."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig
from estimator.store.importers.axis_scan import read_axis_scan

CONFIGS = Path(__file__).parents[4] / "configs"
CURRENT_A = {"coil1": 0.5}


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(CONFIGS / "goettingen_long.yaml")


def written(folder: Path, text: str) -> Path:
    (folder / "scan.dat").write_text(text)
    return folder / "scan.dat"


def test_positions_become_z_and_the_field_the_axial_component(tmp_path, rig):
    o = read_axis_scan(written(tmp_path, "-1 13.5 0.1\n\n20 8.7 0.1\n"), rig, CURRENT_A).observations
    assert o.motion["stage"][:, 2].tolist() == [-0.01, 0.2]
    torch.testing.assert_close(o.field_sensor_T[:, 2], torch.tensor([13.5e-4, 8.7e-4]).double())
    assert o.is_measured.any(0).tolist() == [False, False, True]
    assert o.current_A.tolist() == [[0.5], [0.5]]


def test_other_units_two_columns_and_comments_are_read(tmp_path, rig):
    path = written(tmp_path, "# x B\n  # mm mT\n9 2.295\n")
    o = read_axis_scan(path, rig, CURRENT_A, position_unit="mm", field_unit="mT").observations
    assert o.motion["stage"][:, 2].tolist() == pytest.approx([0.009])
    assert o.field_sensor_T[:, 2].tolist() == pytest.approx([2.295e-3])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "at least one row"),
        ("1\n", "two or three columns; it has 1"),
        ("1 2 3 4\n", "two or three columns; it has 4"),
        ("1 2\n1 2 3\n", r"rows must have 2 cells; received 3 \(.*line 2\)"),
        ("0 1\n1 2,5\n", r"cell 2 must be a finite number; received '2,5' \(.*line 2\)"),
    ],
)
def test_a_table_of_another_kind_is_refused(tmp_path, rig, text, message):
    with pytest.raises(InvalidInput, match=message):
        read_axis_scan(written(tmp_path, text), rig, CURRENT_A)


def test_unknown_units_and_missing_currents_are_refused(tmp_path, rig):
    path = written(tmp_path, "0 1\n")
    with pytest.raises(InvalidInput, match="unit of length must be one of m, cm, mm, um; received 'G'"):
        read_axis_scan(path, rig, CURRENT_A, position_unit="G")
    with pytest.raises(InvalidInput, match="currents must be given for each coil"):
        read_axis_scan(path, rig, {})
    with pytest.raises(InvalidInput, match="current of coil1 must be a finite number"):
        read_axis_scan(path, rig, {"coil1": float("nan")})


@pytest.fixture(scope="module")
def data() -> Path:
    if "COILCAL_DATA" not in os.environ:
        pytest.skip("COILCAL_DATA does not name the folder of measured maps")
    return Path(os.environ["COILCAL_DATA"])


@pytest.mark.parametrize(
    ("name", "file", "n", "currents_A"),
    [
        ("long", "HallLang", 51, CURRENT_A),
        ("thick", "HallDick", 37, CURRENT_A),
        ("helmholtz", "HallHelm", 34, {"coil1": 0.25, "coil2": 0.25}),
    ],
)
def test_goettingen_scans_have_the_shape_of_their_coil(data, name, file, n, currents_A):
    rig = load_rig(CONFIGS / f"goettingen_{name}.yaml")
    o = read_axis_scan(data / "goettingen-axis-scans" / f"{file}.dat", rig, currents_A).observations
    assert len(o) == n
    values = {key: torch.tensor(v, dtype=torch.float64) for key, v in rig.nominal_values().items()}
    if name == "helmholtz":  # its zero is noted as "about the middle"; the maximum is at -1.5 cm
        values["stage.world_from_base.z_m"] += 0.015
    pair = torch.stack((o.field_sensor_T[:, 2], MeasurementModel.build(rig, o).predict(values)[:, 2]))
    assert torch.corrcoef(pair)[0, 1] > 0.99


def test_dortmund_scans_are_read_in_millitesla(data, rig):
    paths = sorted((data / "dortmund-v308-axis-scans").glob("Spule?_*.txt"))
    paths += sorted((data / "dortmund-v308-axis-scans").glob("hh_*.txt"))
    assert len(paths) == 14
    for path in paths:
        o = read_axis_scan(path, rig, CURRENT_A, field_unit="mT").observations
        assert 1e-5 < o.field_sensor_T[:, 2].abs().max() < 1e-2
