"""`coilcal recalibrate --measure` with simulated instruments: the shortest session, killed and gone on with."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from estimator.calibration.result import Calibration
from estimator.recalibration.log import Entry
from estimator.recalibration.registry import Registry
from estimator.store.journal import read_journal
from estimator.store.session import load_session
from tests.estimator.cli.conftest import refused, run
from tests.estimator.cli.test_acquire import BUSY, bring_home, is_off, quicker, running
from tests.estimator.cli.test_acquire_until import PLAN

MOVED_M = 2e-3


@pytest.fixture(scope="module")
def folder(
    tmp_path_factory: pytest.TempPathFactory, rig_text: str, small_calibration: Calibration
) -> Iterator[Path]:
    """A rig that runs whose coil has moved since the calibration in its registry."""
    truth = {name: small_calibration.best[name] for name in small_calibration.draws}
    truth["coil1.world_from_coil0.z_m"] += MOVED_M
    settings = [word for name, value in truth.items() for word in ("--set", f"{name}={value!r}")]
    settings += ["--set", "hall.noise_T=5e-6"]
    with running(tmp_path_factory.mktemp("recheck"), rig_text, PLAN, *settings) as path:
        quicker(path)
        registry = Registry(path / "registry")
        with registry.writing():
            entry = Entry("updated", "first", "first.zarr", taken="2026-01-01T00:00:00+00:00")
            registry.commit(entry, small_calibration)
        yield path


def call(folder: Path, out: Path, *more: object) -> list[str]:
    files = ["--rig", folder / "rig.yaml", "--registry", folder / "registry"]
    places = ["--places", folder / "plan.yaml", "--devices", folder / "devices.yaml", "--change", 1]
    return [str(argument) for argument in ("recalibrate", "--measure", out, *files, *places, *more)]


@pytest.mark.flaky(reruns=2)
def test_a_recheck_names_what_changed(folder, tmp_path):
    bring_home(folder)
    out = tmp_path / "session.zarr"
    for _ in range(4):
        result = run(*call(folder, out, "--json"))
        if BUSY not in result.stderr:
            break
    assert result.exit_code == 10, result.stderr
    shown = json.loads(result.stdout)
    entries = read_journal(out)[1]
    assert shown["stops"] == len(entries) == len(load_session(out).observations) <= 10
    assert shown["ended"]["outcome"] == "changed"
    assert any(words.startswith("coil1.world_from_coil0.z_m by 0.00") for words in shown["ended"]["leading"])
    assert is_off(folder)
    told = run("show", out)
    assert "the calibration has changed" in told.stdout


def test_without_a_calibration_nothing_moves(folder, tmp_path):
    words = [
        word.replace(str(folder / "registry"), str(tmp_path / "registry"))
        for word in call(folder, tmp_path / "s.zarr")
    ]
    assert "registry must have a calibration to measure against" in refused(run(*words))
    assert "--rig must be given with --measure" in refused(
        run("recalibrate", "--registry", tmp_path / "registry", "--measure", tmp_path / "s.zarr")
    )
