"""A calibrated model on disk: it comes back as it was, or not at all."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import arviz
import numpy as np
import pytest
import torch
import xarray as xr
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.errors import CorruptStore, InvalidInput
from tests.estimator.store.damaged import files, flipped, lost

pytestmark = pytest.mark.whole

ON = {"coil1": 3.0}


@pytest.fixture
def points_m() -> Tensor:
    return 0.06 * (torch.rand(40, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64) - 0.5)


@pytest.fixture
def stored(small_calibration: Calibration, tmp_path: Path) -> Path:
    small_calibration.save(tmp_path / "calibration")
    return tmp_path / "calibration"


def test_what_was_saved_is_loaded_with_the_same_field_and_intervals(small_calibration, stored, points_m):
    loaded = Calibration.load(stored)
    assert loaded.rig == small_calibration.rig
    assert loaded.best == small_calibration.best
    assert loaded.summary() == json.loads(json.dumps(small_calibration.summary()))
    assert torch.equal(loaded.field(points_m, ON), small_calibration.field(points_m, ON))
    for loaded_T, computed_T in zip(
        loaded.field_interval(points_m, ON), small_calibration.field_interval(points_m, ON), strict=True
    ):
        assert torch.equal(loaded_T, computed_T)
    for name, draws in small_calibration.draws.items():
        assert np.array_equal(loaded.draws[name], draws)
    assert np.array_equal(loaded.log_prob, small_calibration.log_prob)
    assert torch.equal(loaded.observations.field_sensor_T, small_calibration.observations.field_sensor_T)
    assert torch.equal(loaded.observations.is_validation, small_calibration.observations.is_validation)


def test_what_was_set_or_fixed_after_the_rig_was_read_are_kept(small_calibration, tmp_path):
    rig = small_calibration.rig.with_values({"coil1.wire_radius_m": 0.00097}).with_fixed(["coil1.radius_m"])
    replace(small_calibration, rig=rig).save(tmp_path)
    assert Calibration.load(tmp_path).rig == rig


def test_arviz_opens_the_posterior(small_calibration, stored):
    with xr.open_datatree(stored / "posterior.zarr", engine="zarr", consolidated=False) as tree:
        data = arviz.InferenceData.from_datatree(tree)
        assert data.groups() == ["posterior", "sample_stats", "observed_data", "constant_data"]
        assert dict(data.posterior.sizes) == {"chain": 16, "draw": small_calibration.log_prob.shape[1]}
        radius = data.posterior["coil1.radius_m"]
        assert float(radius.mean()) == pytest.approx(
            small_calibration.summary()["parameters"]["coil1.radius_m"]["median"], rel=1e-3
        )


def test_saving_again_replaces_the_result_whole(small_calibration, stored):
    shorter = replace(
        small_calibration,
        draws={k: v[:, :9] for k, v in small_calibration.draws.items()},
        log_prob=small_calibration.log_prob[:, :9],
    )
    shorter.save(stored)
    assert Calibration.load(stored).log_prob.shape == (16, 9)
    assert sorted(path.name for path in stored.iterdir()) == ["posterior.zarr", "summary.json"]


def test_a_flipped_bit_in_the_posterior_is_found_or_changes_nothing(small_calibration, stored):
    n_found = 0
    for path in flipped(stored / "posterior.zarr", 3):
        try:
            loaded = Calibration.load(stored)
        except CorruptStore:
            n_found += 1
        else:
            assert path.name == "zarr.json"
            assert loaded.best == small_calibration.best
            assert all(np.array_equal(loaded.draws[k], v) for k, v in small_calibration.draws.items())
    assert n_found > 0.9 * 3 * len(files(stored / "posterior.zarr"))


def test_any_lost_file_is_found(stored):
    for _ in lost(stored / "posterior.zarr"):
        with pytest.raises(CorruptStore):
            Calibration.load(stored)


def test_another_schema_version_is_refused(stored):
    group = stored / "posterior.zarr" / "zarr.json"
    group.write_text(
        group.read_text(encoding="utf-8").replace('"schema_version": 1', '"schema_version": 2'),
        encoding="utf-8",
    )
    with pytest.raises(CorruptStore, match="calibration schema_version must be 1; received 2"):
        Calibration.load(stored)


def test_the_folder_of_a_diagnosis_is_refused_with_the_calibration_in_it(tmp_path):
    inner = tmp_path / "calibration"
    inner.mkdir()
    (inner / "summary.json").touch()
    with pytest.raises(
        InvalidInput, match=f"received {tmp_path}; the calibration of this diagnosis is {inner}"
    ):
        Calibration.load(tmp_path)
