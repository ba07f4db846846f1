"""Half a year of a simulated rig through the job: every conclusion, what it leaves, and that it can be repeated."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from estimator.calibration import Calibration
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.plan import Plan
from estimator.recalibrate import HISTORY, _since, recalibrate, roll_back
from estimator.recalibration.judgement import judge
from estimator.registry import Entry, Registry
from estimator.rig import Rig
from estimator.simulate import simulate
from estimator.store.session import Session, load_session

DRIFT_T = 20e-6


@pytest.fixture(scope="module")
def inbox(
    small_rig: Rig, small_plan: Plan, small_truth: dict[str, float], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("inbox")

    def visit(name: str, seed: int, month: int, hidden: Mapping[str, float] | None = None) -> None:
        readings = simulate(small_rig, small_plan, small_truth, seed, hidden)
        session = Session(
            small_rig, readings, f"simulated, seed {seed}", f"2026-{month:02d}-01T09:00:00+00:00"
        )
        session.save(folder / f"{name}.zarr")

    # Names that do not sort by time: readings do.
    visit("z_first", 1, 1)
    visit("y_same", 2, 2)
    visit("x_damaged", 3, 3)
    visit("w_drift", 4, 4, {"background_field.x_T": DRIFT_T})
    chunk = next((folder / "x_damaged.zarr" / "field_sensor_T").rglob("c/*/*"))
    chunk.write_bytes(chunk.read_bytes()[:-5])
    return folder


@pytest.fixture(scope="module")
def done(
    inbox: Path, small_rig: Rig, small_settings: SamplerSettings, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    registry = tmp_path_factory.mktemp("recalibrate") / "registry"
    recalibrate(small_rig, inbox, registry, seed=1, settings=small_settings)
    return registry


def test_sessions_are_taken_in_the_order_of_their_readings(done: Path) -> None:
    # Nobody knows when damaged readings were taken; their files were written last.
    names = [Path(entry.session).stem for entry in Registry(done).entries()]
    assert names == ["z_first", "y_same", "w_drift", "x_damaged"]


def test_first_session_makes_the_first_version(done: Path) -> None:
    first = Registry(done).entries()[0]
    assert (first.conclusion, first.made, first.reason) == ("updated", 1, "first calibration")


def test_a_session_that_agrees_changes_nothing(done: Path) -> None:
    same = Registry(done).entries()[1]
    assert (same.conclusion, same.version, same.made, same.agrees) == ("unchanged", 1, None, True)
    assert same.checks["p_value"] > 0.001
    assert set(same.estimate) == {"coil1.radius_m", "coil1.axial_loops", "coil1.world_from_coil0.z_m"}


def test_a_damaged_session_is_rejected(done: Path) -> None:
    damaged = Registry(done).entries()[3]
    assert (damaged.conclusion, damaged.version, damaged.made) == ("rejected", 2, None)
    assert damaged.reason.startswith("the session cannot be read: ")


def test_a_drift_is_named_with_its_size_and_since_when_and_the_rig_is_extended(done: Path) -> None:
    drift = Registry(done).entries()[2]
    assert (drift.conclusion, drift.made, drift.since) == ("drifted", 2, "2026-04-01T09:00:00+00:00")
    (cause,) = drift.causes
    names = {cause["name"], *(other["name"] for other in cause["alternatives"])}
    assert names <= {"background_field", "sensor_offset"}  # twins under a fixed sensor
    lower, upper = cause["parameters"]["x_T"]["ci90"]
    assert abs(0.5 * (lower + upper)) == pytest.approx(DRIFT_T, rel=0.3)
    assert drift.checks["elpd_difference"] > 2.0 * drift.checks["elpd_se"]
    extended = Registry(done).calibration()
    assert [one.name for one in extended.rig.effects] == [cause["name"]]
    assert extended.record["is_converged"]


def test_the_same_call_again_does_nothing_and_the_inbox_is_as_it_was(
    done: Path, inbox: Path, small_rig: Rig, small_settings: SamplerSettings, tmp_path: Path
) -> None:
    registry = shutil.copytree(done, tmp_path / "registry", symlinks=True)
    before = {path: path.stat().st_mtime_ns for path in inbox.rglob("*")}
    assert recalibrate(small_rig, inbox, registry, seed=1, settings=small_settings) == []
    assert {path: path.stat().st_mtime_ns for path in inbox.rglob("*")} == before
    assert len(Registry(registry).entries()) == 4


def test_rolling_back_makes_an_earlier_version_current_and_says_so_on_the_page(
    done: Path, tmp_path: Path
) -> None:
    registry = shutil.copytree(done, tmp_path / "registry", symlinks=True)
    assert roll_back(registry, 1).version == 1
    assert Registry(registry).current == 1
    assert "Version 1 is in use" in (registry / HISTORY).read_text(encoding="utf-8")


def test_page_names_the_drift(done: Path) -> None:
    page = (done / HISTORY).read_text(encoding="utf-8")
    assert "Version 2 is in use" in page
    assert "Drift since 2026-04-01" in page
    assert "the session cannot be read" in page.lower()


def test_another_rig_and_a_missing_inbox_are_refused_before_anything_is_logged(
    done: Path, inbox: Path, small_rig: Rig, two_coils_text: str, tmp_path: Path
) -> None:
    from estimator.config import rig_from_text

    with pytest.raises(InvalidInput, match="must name the coils, sensors and movers of the registry"):
        recalibrate(rig_from_text(two_coils_text), inbox, done)
    with pytest.raises(InvalidInput, match="inbox must be a folder of sessions"):
        recalibrate(small_rig, tmp_path / "none", tmp_path / "registry")


def test_a_coil_mounted_anew_updates_the_calibration(
    small_calibration: Calibration,
    small_rig: Rig,
    small_plan: Plan,
    small_truth: dict[str, float],
    small_settings: SamplerSettings,
) -> None:
    truth = {**small_truth, "coil1.world_from_coil0.z_m": -0.0405}
    session = Session(small_rig, simulate(small_rig, small_plan, truth, seed=7), "simulated")
    found = judge(session, small_rig, small_calibration, seed=1, settings=small_settings)
    assert found.conclusion == "updated"
    assert "coil1.world_from_coil0.z moved by" in found.reason
    assert found.calibration is not None
    z = found.calibration.record["parameters"]["coil1.world_from_coil0.z_m"]
    assert z["median"] == pytest.approx(-0.0405, abs=4.0 * z["sd"])


@pytest.mark.parametrize("factor", [-1.0, 1000.0])
def test_mistakes_of_the_record_are_rejected(
    small_calibration: Calibration, small_rig: Rig, small_session: Session, factor: float
) -> None:
    readings = small_session.observations
    wrong = replace(small_session, observations=readings.with_field(factor * readings.field_sensor_T))
    found = judge(wrong, small_rig, small_calibration, seed=1)
    assert found.conclusion == "rejected"
    assert found.calibration is None
    assert ("current_sign" if factor < 0.0 else "fields look like mT") in found.reason


def entry(taken: str, agrees: bool | None, made: int | None = None) -> Entry:
    return Entry("rejected", "", "a.zarr", "hash", taken, agrees=agrees, made=made)


@pytest.mark.parametrize(
    ("entries", "since"),
    [
        ([entry("1", True)], "9"),
        ([entry("1", True), entry("2", False), entry("3", None), entry("4", False)], "2"),
        ([entry("1", False), entry("2", False, made=2), entry("3", False)], "3"),
        ([entry("1", False), Entry("rolled_back", "")], "9"),
        ([], "9"),
    ],
)
def test_a_drift_began_with_the_first_session_in_a_row_that_disagreed(
    entries: list[Entry], since: str
) -> None:
    assert _since(entries, "9") == since


def test_log_lines_are_plain_json(done: Path, inbox: Path) -> None:
    lines = (done / "log.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["hash"] for line in lines[:2]] == [
        load_session(inbox / f"{name}.zarr").hash for name in ("z_first", "y_same")
    ]
