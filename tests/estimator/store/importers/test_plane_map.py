"""Plane maps: position and currents of each cell, and the relative sign of the pair's currents."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig
from estimator.store.importers.plane_map import read_plane_maps

CONFIGS = Path(__file__).parents[4] / "configs"


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(CONFIGS / "maxwell_pair.yaml")


def written(folder: Path, name: str, rows: int = 14) -> Path:
    """A map whose cell in row i, column j reads 100 i + j gauss."""
    lines = [",A,B,C,D,E,F,G,H,I,J,K"]
    lines += [",".join(str(x) for x in (i + 1, *(100 * i + j for j in range(11)))) for i in range(rows)]
    (folder / name).write_text("\n".join(lines) + "\n")
    return folder / name


def test_rows_are_transverse_and_columns_axial_in_gauss(tmp_path, rig):
    o = read_plane_maps([written(tmp_path, "u1_1_9_u2_0_r1.csv")], rig).observations
    assert len(o) == 154
    for i, j in ((0, 0), (0, 10), (13, 0), (6, 5)):
        pose = o.motion["stage"][11 * i + j]
        torch.testing.assert_close(pose[:3], torch.tensor([-0.06 + 0.01 * i, 0.0, -0.05 + 0.01 * j]).double())
        assert o.field_sensor_T[11 * i + j, 2].item() == pytest.approx((100 * i + j) * 1e-4)
    assert o.is_measured.any(0).tolist() == [False, False, True]


def test_currents_and_repeats_come_from_the_names(tmp_path, rig):
    paths = [written(tmp_path, name) for name in ("u1_1_9_u2_0_r2.csv", "u1_0_5_u2_-1_9_r3.csv")]
    o = read_plane_maps(paths, rig).observations
    assert o.current_A[[0, 153, 154, 307]].tolist() == [[1.9, 0.0], [1.9, 0.0], [0.5, -1.9], [0.5, -1.9]]
    assert o.repeat[[0, 153, 154, 307]].tolist() == [2, 2, 3, 3]
    assert o.segment[[0, 153, 154, 307]].tolist() == [0, 0, 1, 1]
    assert len(o.time_s.unique()) == 308
    given = read_plane_maps(paths, rig, {"coil2": 2.0, "coil1": 1.0}).observations
    assert given.current_A.unique(dim=0).tolist() == [[1.0, 2.0]]


def test_files_that_do_not_fit_are_refused(tmp_path, rig):
    with pytest.raises(InvalidInput, match="at least one file"):
        read_plane_maps([], rig)
    with pytest.raises(InvalidInput, match="14 rows of 12 cells; it holds"):
        read_plane_maps([written(tmp_path, "u1_1_u2_0_r1.csv", rows=13)], rig)
    with pytest.raises(InvalidInput, match="file name must read u1_<ampere>"):
        read_plane_maps([written(tmp_path, "map.csv")], rig)
    with pytest.raises(InvalidInput, match="must have two coils"):
        read_plane_maps([written(tmp_path, "u1_1_u2_0_r1.csv")], load_rig(CONFIGS / "goettingen_long.yaml"))
    with pytest.raises(InvalidInput, match="must have one mover, of motion pose"):
        read_plane_maps([written(tmp_path, "u1_1_u2_0_r1.csv")], load_rig(CONFIGS / "two_arms.yaml"))


@pytest.fixture(scope="module")
def maps() -> Path:
    if "COILCAL_DATA" not in os.environ:
        pytest.skip("COILCAL_DATA does not name the folder of measured maps")
    return Path(os.environ["COILCAL_DATA"]) / "maxwell-pair-plane-maps"


def test_measured_maps_follow_the_sign_convention_of_the_rig(maps, rig):
    values = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
    for u2, n_maps in (("0", 5), ("1_9", 4), ("-1_9", 4)):
        o = read_plane_maps(sorted(maps.glob(f"u1_1_9_u2_{u2}_r*.csv")), rig).observations
        assert len(o) == 154 * n_maps
        pair = torch.stack((o.field_sensor_T[:, 2], MeasurementModel.build(rig, o).predict(values)[:, 2]))
        assert torch.corrcoef(pair)[0, 1] > 0.8  # with the sign of u2 reversed: -0.02
