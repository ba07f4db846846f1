"""Maps of single coils on grids are read in their units, and files that say something else than they hold are refused."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig
from estimator.store.importers.grid_maps import read_grid_maps

CONFIGS = Path(__file__).parents[4] / "configs"
TEXT = """2
2 1 1
-0.005 0.005
0 0
0 0
-0.005 0 0 1e-3 2e-3 3e-3
0.005 0 0 4e-3 5e-3 6e-3
"""


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(CONFIGS / "mfg_8coil.yaml")


def written(folder: Path, text: str = TEXT, name: str = "vfield_02.txt") -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_each_file_is_one_coil_at_one_ampere(tmp_path, rig):
    session = read_grid_maps([written(tmp_path), written(tmp_path, name="vfield_07.txt")], rig)
    o = session.observations
    assert o.motion["stage"][:, 0].tolist() == [-0.005, 0.005] * 2
    assert o.field_sensor_T[1].tolist() == [4e-3, 5e-3, 6e-3]
    on = [[float(i == coil) for i in range(8)] for coil in (2, 2, 7, 7)]
    assert o.current_A.tolist() == on
    assert "the source does not say which" in session.source


def test_maps_may_stand_for_another_current(tmp_path, rig):
    assert read_grid_maps([written(tmp_path)], rig, {"c3": 2.5}).observations.current_A[0, 2] == 2.5
    with pytest.raises(InvalidInput, match="must name coils of the rig .*; received 'c9'"):
        read_grid_maps([written(tmp_path)], rig, {"c9": 1.0})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must begin with the number of points"),
        (TEXT.replace("2\n2 1 1", "3\n3 1 1"), "must hold 3 rows of 6 numbers; it holds 2 of 6"),
        (TEXT.replace(" 3e-3", ""), "rows must have"),
        (TEXT.replace("\n0.005", "\n5"), "must hold points within the ranges of its header"),
        (TEXT.replace("4e-3", "4,1"), "must be a finite number; received '4,1'"),
    ],
)
def test_a_file_of_another_kind_is_refused(tmp_path, rig, text, message):
    with pytest.raises(InvalidInput, match=message):
        read_grid_maps([written(tmp_path, text)], rig)


@pytest.mark.parametrize("name", ["vfield_08.txt", "field_02.txt"])
def test_a_file_that_tells_no_coil_is_refused(tmp_path, rig, name):
    with pytest.raises(InvalidInput, match=r"with a number below 8 for the coils of rig .*received"):
        read_grid_maps([written(tmp_path, name=name)], rig)


@pytest.mark.skipif("COILCAL_DATA" not in os.environ, reason="needs the maps below COILCAL_DATA")
def test_the_maps_of_the_repository_are_read(rig):
    folder = Path(os.environ["COILCAL_DATA"]) / "mfg-8coil-ironcore-maps"
    o = read_grid_maps(sorted(folder.glob("vfield_*.txt")), rig).observations
    assert (len(o), o.motion["stage"].abs().max()) == (8 * 1331, 0.005)
    assert torch.equal(o.current_A.sum(0), torch.full((8,), 1331.0).double())
