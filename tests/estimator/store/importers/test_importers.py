"""All importers have the same signature."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimator.errors import InvalidInput
from estimator.rig_files.read import load_rig
from estimator.store.importers import IMPORTERS
from estimator.store.importers.axis_scan import read_axis_scan
from estimator.units import UNITS

CONFIGS = Path(__file__).parents[4] / "configs"


def test_every_format_is_called_with_files_rig_and_currents(tmp_path):
    rig = load_rig(CONFIGS / "goettingen_long.yaml")
    path = tmp_path / "scan.dat"
    path.write_text("0 1\n")
    session = IMPORTERS["axis_scan"]([path], rig, {"coil1": 0.5})
    assert session.hash == read_axis_scan(path, rig, {"coil1": 0.5}).hash
    assert session.observations.field_sensor_T[0, 2].item() == UNITS["G"].to_si
    for importer in IMPORTERS.values():
        with pytest.raises(InvalidInput, match=r"must be readable|name"):
            importer([tmp_path / "none"], rig, {"coil1": 0.5})
