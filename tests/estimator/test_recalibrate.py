"""A season of a simulated rig through the job: every conclusion, what it leaves, and that it can be repeated."""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from estimator.calibration import Calibration
from estimator.config import rig_from_text
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.plan import Plan
from estimator.recalibrate import HISTORY, _since, recalibrate, roll_back
from estimator.recalibration.judgement import Conclusion, Judgement, judge
from estimator.registry import Entry, Registry
from estimator.rig import Rig
from estimator.simulate import simulate
from estimator.store.session import Session, load_session

DRIFT_T = 20e-6
recalibrate_module = importlib.import_module(
    "estimator.recalibrate"
)  # the package has a function of that name


def visit(session: Session, folder: Path, name: str, month: int) -> None:
    created = f"2026-{month:02d}-01T09:00:00+00:00"
    replace(session, created=created).save(folder / f"{name}.zarr")


@pytest.fixture
def inbox(
    small_session: Session, small_rig: Rig, small_plan: Plan, small_truth: dict[str, float], tmp_path: Path
) -> Path:
    """Four months, under names that do not sort by time."""
    folder = tmp_path / "inbox"

    def simulated(seed: int, hidden: Mapping[str, float] | None = None) -> Session:
        return replace(small_session, observations=simulate(small_rig, small_plan, small_truth, seed, hidden))

    visit(small_session, folder, "z_first", 1)
    visit(simulated(2), folder, "y_same", 2)
    visit(simulated(3), folder, "x_damaged", 3)
    visit(simulated(4, {"background_field.x_T": DRIFT_T}), folder, "w_drift", 4)
    chunk = next((folder / "x_damaged.zarr" / "field_sensor_T").rglob("c/*/*"))
    chunk.write_bytes(chunk.read_bytes()[:-5])
    return folder


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch, small_calibration: Calibration) -> None:
    """A judge that calls the first session an update and every later one unchanged."""

    def judged(_session: Session, _rig: Rig, current: Calibration | None, **_: object) -> Judgement:
        if current is None:
            return Judgement(Conclusion.UPDATED, "first calibration", small_calibration)
        return Judgement(Conclusion.UNCHANGED, "agrees", agrees=True)

    monkeypatch.setattr(recalibrate_module, "judge", judged)


def test_a_season_ends_with_the_drift_named_and_the_rig_extended(
    inbox: Path, small_rig: Rig, small_settings: SamplerSettings, tmp_path: Path
) -> None:
    registry = Registry(tmp_path / "registry")
    recalibrate(small_rig, inbox, registry.folder, seed=1, settings=small_settings)
    first, same, drift, damaged = registry.entries()
    # Nobody knows when damaged readings were taken; their files were written last.
    names = [Path(entry.session).stem for entry in (first, same, drift, damaged)]
    assert names == ["z_first", "y_same", "w_drift", "x_damaged"]

    assert (first.conclusion, first.made, first.reason) == ("updated", 1, "first calibration")

    assert (same.conclusion, same.version, same.made, same.agrees) == ("unchanged", 1, None, True)
    assert same.checks["p_value"] > 0.001
    assert set(same.estimate) == {"coil1.radius_m", "coil1.axial_loops", "coil1.world_from_coil0.z_m"}

    assert (drift.conclusion, drift.made, drift.since) == ("drifted", 2, "2026-04-01T09:00:00+00:00")
    (cause,) = drift.causes
    named = {cause["name"], *(other["name"] for other in cause["alternatives"])}
    assert named <= {"background_field", "sensor_offset"}  # twins under a fixed sensor
    lower, upper = cause["parameters"]["x_T"]["ci90"]
    assert abs(0.5 * (lower + upper)) == pytest.approx(DRIFT_T, rel=0.3)
    assert drift.checks["elpd_difference"] > 2.0 * drift.checks["elpd_se"]
    extended = registry.calibration()
    assert [one.name for one in extended.rig.effects] == [cause["name"]]
    assert extended.record["is_converged"]

    assert (damaged.conclusion, damaged.version, damaged.made) == ("rejected", 2, None)
    assert damaged.reason.startswith("the session cannot be read: ")

    page = (registry.folder / HISTORY).read_text(encoding="utf-8")
    assert "Version 2 is in use" in page
    assert "Drift since 2026-04-01" in page


@pytest.mark.usefixtures("told")
def test_the_same_call_again_does_nothing_and_the_inbox_is_as_it_was(
    inbox: Path, small_rig: Rig, tmp_path: Path
) -> None:
    before = {path: path.stat().st_mtime_ns for path in inbox.rglob("*")}
    assert len(recalibrate(small_rig, inbox, tmp_path / "registry")) == 4
    assert recalibrate(small_rig, inbox, tmp_path / "registry") == []
    assert {path: path.stat().st_mtime_ns for path in inbox.rglob("*")} == before
    assert len(Registry(tmp_path / "registry").entries()) == 4


@pytest.mark.usefixtures("told")
def test_a_job_that_ended_between_two_sessions_goes_on_with_the_next(
    inbox: Path, small_rig: Rig, tmp_path: Path
) -> None:
    def end(_: Entry) -> None:
        raise KeyboardInterrupt

    for n in range(1, 5):
        with pytest.raises(KeyboardInterrupt):
            recalibrate(small_rig, inbox, tmp_path / "registry", on_entry=end)
        assert len(Registry(tmp_path / "registry").entries()) == n
    assert recalibrate(small_rig, inbox, tmp_path / "registry", on_entry=end) == []


@pytest.mark.usefixtures("told")
def test_rolling_back_is_on_the_page_and_log_lines_are_plain_json(
    inbox: Path, small_rig: Rig, small_calibration: Calibration, tmp_path: Path
) -> None:
    registry = Registry(tmp_path / "registry")
    recalibrate(small_rig, inbox, registry.folder)
    with registry.writing():
        registry.commit(
            Entry("updated", "again", "b.zarr", "b", "2026-05-01T09:00:00+00:00"), small_calibration
        )
    assert roll_back(registry.folder, 1).version == 1
    assert registry.current == 1
    assert "Version 1 is in use" in (registry.folder / HISTORY).read_text(encoding="utf-8")
    lines = (registry.folder / "log.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(lines[0])["hash"] == load_session(inbox / "z_first.zarr").hash
    assert json.loads(lines[-1])["conclusion"] == "rolled_back"


@pytest.mark.usefixtures("told")
def test_another_rig_and_a_missing_inbox_are_refused_before_anything_is_logged(
    inbox: Path, small_rig: Rig, two_coils_text: str, tmp_path: Path
) -> None:
    registry = tmp_path / "registry"
    recalibrate(small_rig, inbox, registry)
    with pytest.raises(InvalidInput, match="must name the coils, sensors and movers of the registry"):
        recalibrate(rig_from_text(two_coils_text), inbox, registry)
    with pytest.raises(InvalidInput, match="inbox must be a folder of sessions"):
        recalibrate(small_rig, tmp_path / "none", registry)
    assert len(Registry(registry).entries()) == 4


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


@pytest.mark.parametrize("factor", [pytest.param(-1.0, marks=pytest.mark.slow), 1000.0])
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
