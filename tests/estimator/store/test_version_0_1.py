"""What version 0.1 wrote still opens, with the same hashes: a session, a growing one, a calibration and a registry."""

from __future__ import annotations

import json
import tarfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from estimator.calibration.result import Calibration
from estimator.recalibration.registry import Registry
from estimator.rig_files.read import load_rig
from estimator.store.session import load_session

STORES = Path(__file__).resolve().parents[2] / "fixtures" / "version_0_1.tar.gz"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stores")
    with tarfile.open(STORES) as tar:
        tar.extractall(path, filter="data")
    return path / "version_0_1"


@pytest.fixture(scope="module")
def hashes(folder: Path) -> Mapping[str, str]:
    return dict(json.loads((folder / "expected.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize("name", ["session.zarr", "session_fixed.zarr", "growing.zarr"])
def test_a_session_has_its_hash_and_keeps_it_when_it_is_saved_again(folder, hashes, name, tmp_path):
    session = load_session(folder / name)
    assert session.hash == hashes[name]
    session.save(tmp_path / "again.zarr")
    assert load_session(tmp_path / "again.zarr").hash == hashes[name]


def test_values_that_were_set_and_parameters_that_were_fixed_stay_so(folder, hashes):
    described, fixed = (load_session(folder / name).rig for name in ("session.zarr", "session_fixed.zarr"))
    assert (described.hash, fixed.hash) == (hashes["rig"], hashes["rig_fixed"])
    assert fixed.parameters["coil1.radius_m"].value == 0.0517
    assert [p.name for p in described.free if p not in fixed.free] == ["coil1.radius_m", "coil1.axial_loops"]
    assert fixed.parameters["coil1.axial_loops"].prior is None
    assert described.devices["hall"]["range_mT"] == 350


def test_the_hash_of_a_session_is_that_of_its_own_rig_when_another_takes_its_place(folder, tmp_path):
    session = load_session(folder / "session.zarr")
    other = replace(session, rig=session.rig.with_values({"coil1.radius_m": 0.05}))
    assert other.hash != session.hash
    other.save(tmp_path / "other.zarr")
    again = load_session(tmp_path / "other.zarr")
    assert (again.rig, again.hash) == (other.rig, other.hash)


def test_a_calibration_opens_and_opens_again_when_it_is_saved(folder, tmp_path):
    calibration = Calibration.load(folder / "calibration")
    assert calibration.rig == load_session(folder / "session.zarr").rig
    calibration.save(tmp_path / "again")
    again = Calibration.load(tmp_path / "again")
    assert (again.rig, again.best) == (calibration.rig, calibration.best)
    assert again.rig.hash == calibration.rig.hash == again.summary()["rig_hash"]


def test_a_registry_knows_its_version_and_the_sessions_that_it_has_judged(folder, hashes):
    registry = Registry(folder / "registry")
    assert (registry.current, registry.versions) == (1, (1,))
    assert registry.calibration().rig.hash == hashes["rig"]
    assert load_rig(folder / "registry/current/rig.yaml") == registry.calibration().rig
    assert [entry.hash for entry in registry.entries()] == [load_session(folder / "session.zarr").hash]
