"""A season of a simulated rig through the job: every conclusion, what it leaves, and that it can be repeated."""

from __future__ import annotations

import importlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.recalibration import arrivals as arrivals_module
from estimator.recalibration import comparison, policy
from estimator.recalibration.arrivals import arrivals
from estimator.recalibration.conclusion import Conclusion, Judgement
from estimator.recalibration.judgement import judge
from estimator.recalibration.log import Entry
from estimator.recalibration.recalibrate import HISTORY, _in_use, _since, recalibrate, roll_back
from estimator.recalibration.registry import Registry
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.growing import new_header
from estimator.store.journal import Journal
from estimator.store.session import Session, load_session

DRIFT_T = 20e-6
recalibrate_module = importlib.import_module(
    "estimator.recalibration.recalibrate"
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


@pytest.fixture(autouse=True)
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is being copied: what cannot be read is damaged."""
    monkeypatch.setattr(policy, "SETTLED_S", 0.0)


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch, small_calibration: Calibration) -> None:
    """A judge that calls the first session an update and every later one unchanged."""

    def judged(_session: Session, _rig: Rig, current: Calibration | None, **_: object) -> Judgement:
        if current is None:
            return Judgement(Conclusion.UPDATED, "first calibration", small_calibration)
        return Judgement(Conclusion.UNCHANGED, "agrees", agrees=True)

    monkeypatch.setattr(recalibrate_module, "judge", judged)


def test_a_season_ends_with_the_drift_named_and_the_rig_extended(
    inbox, small_rig, small_settings, tmp_path, monkeypatch
):
    monkeypatch.setattr(comparison, "held_back", lambda _: ["The prior holds it back."])
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
    assert drift.reason.endswith(". The prior holds it back")
    assert drift.checks["elpd_difference"] > 2.0 * drift.checks["elpd_se"]
    extended = registry.calibration()
    assert [one.name for one in extended.rig.effects] == [cause["name"]]
    assert extended.summary()["is_converged"]

    assert (damaged.conclusion, damaged.version, damaged.made) == ("rejected", 2, None)
    assert damaged.reason.startswith("the session cannot be read: ")

    page = (registry.folder / HISTORY).read_text(encoding="utf-8")
    assert "Version 2 is in use" in page
    assert "Drift since 2026-04-01" in page


@pytest.mark.usefixtures("told")
def test_the_same_call_again_does_nothing_and_the_inbox_is_as_it_was(inbox, small_rig, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in inbox.rglob("*")}
    assert len(recalibrate(small_rig, inbox, tmp_path / "registry")) == 4
    assert recalibrate(small_rig, inbox, tmp_path / "registry") == []
    assert {path: path.stat().st_mtime_ns for path in inbox.rglob("*")} == before
    assert len(Registry(tmp_path / "registry").entries()) == 4


@pytest.mark.usefixtures("told")
def test_a_job_that_ended_before_it_could_tell_is_told_of_by_the_next_and_goes_on(inbox, small_rig, tmp_path):
    registry = Registry(tmp_path / "registry")
    heard: list[str] = []

    def end_once(entry: Entry) -> None:
        if entry.hash not in heard:
            heard.append(entry.hash)
            raise KeyboardInterrupt

    for n in range(1, 5):
        with pytest.raises(KeyboardInterrupt):
            recalibrate(small_rig, inbox, registry.folder, on_entry=end_once)
        assert len(registry.entries()) == n
    (last,) = recalibrate(small_rig, inbox, registry.folder, on_entry=end_once)
    assert last == registry.entries()[-1]
    assert recalibrate(small_rig, inbox, registry.folder, on_entry=end_once) == []


@pytest.mark.usefixtures("told")
def test_lines_of_a_registry_that_did_not_count_them_are_not_told_again(inbox, small_rig, tmp_path):
    recalibrate(small_rig, inbox, tmp_path / "registry")
    (tmp_path / "registry" / "told").unlink()
    assert recalibrate(small_rig, inbox, tmp_path / "registry") == []


@pytest.mark.usefixtures("told")
def test_a_session_is_judged_again_where_that_is_asked_for(inbox, small_rig, tmp_path):
    recalibrate(small_rig, inbox, tmp_path / "registry")
    (again,) = recalibrate(small_rig, inbox, tmp_path / "registry", again=["y_same.zarr"])
    assert Path(again.session).name == "y_same.zarr"
    with pytest.raises(InvalidInput, match="must lie in the inbox; received 'none.zarr'"):
        recalibrate(small_rig, inbox, tmp_path / "registry", again=["none.zarr"])


@pytest.mark.usefixtures("told")
def test_provenance_says_with_what_a_version_was_made(inbox, small_rig, tmp_path, monkeypatch):
    monkeypatch.setattr(recalibrate_module, "code_version", lambda: "abc-dirty")
    settings = SamplerSettings(target_ess=123.0)
    recalibrate(small_rig, inbox, tmp_path / "registry", seed=5, settings=settings)
    path = tmp_path / "registry" / "current" / "provenance.json"
    provenance = json.loads(path.read_text(encoding="utf-8"))
    assert provenance["described_rig_hash"] == small_rig.hash
    assert (provenance["settings"]["target_ess"], provenance["settings"]["seed"]) == (123.0, 5)
    assert provenance["code"] == "abc-dirty"


def test_a_session_that_is_measured_or_copied_is_left_for_the_next_time_and_it_is_said(
    inbox, small_rig, tmp_path, monkeypatch, told
):
    del told
    monkeypatch.setattr(policy, "SETTLED_S", 60.0)
    shutil.rmtree(inbox / "w_drift.zarr")
    with Journal.create(inbox / "w_drift.zarr", new_header(small_rig, "measured", "plan", {})):
        pass
    waited: dict[str, str] = {}
    recalibrate(
        small_rig, inbox, tmp_path / "registry", on_waiting=lambda path, why: waited.update({path.name: why})
    )
    assert waited["w_drift.zarr"].startswith("it is still being measured")
    assert waited["x_damaged.zarr"].startswith("it cannot be read and changed less than a minute ago")
    assert [Path(e.session).stem for e in Registry(tmp_path / "registry").entries()] == ["z_first", "y_same"]
    monkeypatch.setattr(policy, "SETTLED_S", 0.0)
    (late,) = recalibrate(small_rig, inbox, tmp_path / "registry")
    assert Path(late.session).stem == "x_damaged"


@pytest.mark.usefixtures("told")
def test_a_session_that_vanished_while_others_were_judged_is_left_for_the_next_time(
    inbox, small_rig, tmp_path
):
    def take_away(_: Entry) -> None:
        shutil.rmtree(inbox / "w_drift.zarr", ignore_errors=True)

    waited: list[str] = []
    told = recalibrate(
        small_rig,
        inbox,
        tmp_path / "registry",
        on_entry=take_away,
        on_waiting=lambda path, _why: waited.append(path.name),
    )
    assert (len(told), waited) == (3, ["w_drift.zarr"])


def test_two_things_without_anything_in_them_are_told_apart(tmp_path):
    for name in ("a.zarr", "b.zarr"):
        (tmp_path / name).write_bytes(b"")
        (tmp_path / f"folder_{name}").mkdir()
    arrived, waiting = arrivals(tmp_path)
    assert len({arrival.hash for arrival in arrived}) == 4
    assert not waiting


def test_what_the_system_refuses_to_read_is_one_bad_session_and_what_is_gone_is_none(inbox, monkeypatch):
    def load(path: Path) -> Session:
        if path.stem == "w_drift":
            raise PermissionError(13, "Permission denied", str(path))
        if path.stem == "x_damaged":
            shutil.rmtree(path)
        return load_session(path)

    real = Path.read_bytes

    def read(path: Path) -> bytes:
        if "w_drift" in str(path):
            raise PermissionError(13, "Permission denied", str(path))
        return real(path)

    monkeypatch.setattr(arrivals_module, "load_session", load)
    monkeypatch.setattr(Path, "read_bytes", read)
    arrived, _ = arrivals(inbox)
    assert {a.path.stem: a.fault for a in arrived} == {
        "z_first": "",
        "y_same": "",
        "w_drift": "Permission denied",
    }


def test_an_older_session_that_comes_late_never_replaces_the_calibration_of_a_later_one(
    inbox, small_session, small_rig, small_plan, small_truth, small_calibration, tmp_path
):
    shutil.rmtree(inbox)
    registry = Registry(tmp_path / "registry")
    with registry.writing():
        may = Entry("updated", "first calibration", "may.zarr", "hash", "2026-05-01T09:00:00+00:00")
        registry.commit(may, small_calibration)
    moved = simulate(small_rig, small_plan, {**small_truth, "coil1.world_from_coil0.z_m": -0.0405}, seed=7)
    visit(replace(small_session, observations=moved), inbox, "january", 1)
    *_, late = recalibrate(small_rig, inbox, registry.folder, seed=1)
    assert (late.conclusion, late.made, late.version, late.agrees) == ("unchanged", None, 1, False)
    assert late.reason.startswith(
        "comes late: its readings are older than those of version 1, which stays; compared with"
    )
    assert late.estimate["coil1.world_from_coil0.z_m"][0] == pytest.approx(-0.0405, abs=2e-4)
    assert _since(registry.entries(), "9") == "9"


@pytest.mark.parametrize(
    ("taken", "current", "beside"),
    [("5", 3, 3), ("9", 3, 3), ("4", 3, 2), ("2", 3, 1), ("0", 3, 1), ("2", 1, 1)],
)
def test_readings_are_compared_with_the_version_of_their_time(taken, current, beside):
    entries = [entry("1", None, made=1), entry("3", None, made=2), entry("5", None, made=3)]
    assert _in_use(entries, current, taken) == beside


@pytest.mark.usefixtures("told")
def test_rolling_back_is_on_the_page_and_log_lines_are_plain_json(
    inbox, small_rig, small_calibration, tmp_path
):
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
    inbox, small_rig, two_coils_text, tmp_path
):
    registry = tmp_path / "registry"
    recalibrate(small_rig, inbox, registry)
    with pytest.raises(InvalidInput, match="must name the coils, sensors and movers of the registry"):
        recalibrate(rig_from_text(two_coils_text), inbox, registry)
    with pytest.raises(InvalidInput, match="inbox must be a folder of sessions"):
        recalibrate(small_rig, tmp_path / "none", registry)
    assert len(Registry(registry).entries()) == 4


def test_a_coil_mounted_anew_updates_the_calibration(
    small_calibration, small_rig, small_plan, small_truth, small_settings
):
    truth = {**small_truth, "coil1.world_from_coil0.z_m": -0.0405}
    session = Session(small_rig, simulate(small_rig, small_plan, truth, seed=7), "simulated")
    judged = judge(session, small_rig, small_calibration, seed=1, settings=small_settings)
    assert judged.conclusion == "updated"
    assert "coil1.world_from_coil0.z moved most, by" in judged.reason
    assert "where it was read the coils' field is " in judged.reason
    assert judged.calibration is not None
    z = judged.calibration.summary()["parameters"]["coil1.world_from_coil0.z_m"]
    assert z["median"] == pytest.approx(-0.0405, abs=4.0 * z["sd"])


@pytest.mark.parametrize("factor", [pytest.param(-1.0, marks=pytest.mark.slow), 1000.0])
def test_mistakes_of_the_record_are_rejected(small_calibration, small_rig, small_session, factor):
    readings = small_session.observations
    wrong = replace(small_session, observations=readings.with_field(factor * readings.field_sensor_T))
    judged = judge(wrong, small_rig, small_calibration, seed=1)
    assert judged.conclusion == "rejected"
    assert judged.calibration is None
    assert ("current_sign" if factor < 0.0 else "fields look like mT") in judged.reason


def entry(taken: str, agrees: bool | None, made: int | None = None) -> Entry:
    return Entry("rejected", "", "a.zarr", "hash", taken, agrees=agrees, made=made)


MISTAKE = replace(entry("2", False), causes=({"name": "axes_swapped"},))
LATE_ONE = replace(entry("0", False), checks={"compared_with_version": 1})


@pytest.mark.parametrize(
    ("entries", "since"),
    [
        ([entry("1", True)], "9"),
        ([entry("1", True), entry("2", False), entry("3", None), entry("4", False)], "2"),
        ([entry("1", False), entry("2", False, made=2), entry("3", False)], "3"),
        ([entry("1", False), Entry("rolled_back", "")], "9"),
        ([], "9"),
        ([entry("1", True), MISTAKE, entry("3", False)], "3"),  # swapped axes are no drift
        ([entry("1", True), LATE_ONE, entry("3", False)], "3"),
    ],
)
def test_a_drift_began_with_the_first_session_in_a_row_that_disagreed(entries, since):
    assert _since(entries, "9") == since
