"""The alert command of the settings hears of each conclusion that calls for action, at least once, and no request can name it."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from estimator.errors import InvalidInput
from estimator.recalibration.log import Entry
from estimator.recalibration.registry import Registry
from estimator.service import alerts, tasks
from estimator.service.alerts import ALERTS, leave_alert, run_alerts
from estimator.service.settings import load_settings
from estimator.service.tasks import AssignedJob
from estimator.store.session import Session
from tests.estimator.service.conftest import QUICK

DRIFT = Entry(
    "drifted",
    "the sensor has an offset",
    "/data/sessions/abc.zarr",
    "a" * 64,
    concluded="2026-11-23T10:00:00+00:00",
)
LATER = Entry(
    "rejected",
    "nothing explains it",
    "/data/sessions/def.zarr",
    "b" * 64,
    concluded="2026-11-23T11:00:00+00:00",
)


def command(heard: Path) -> str:
    return f"sh -c 'cat >> {heard}; echo >> {heard}'"


def test_the_command_hears_of_what_waits_once_and_in_order(tmp_path):
    for entry in (LATER, DRIFT):
        leave_alert(tmp_path / ALERTS, "small", entry)
    run_alerts("", tmp_path / ALERTS)
    for _ in range(2):
        run_alerts(command(tmp_path / "heard"), tmp_path / ALERTS)
    heard = [json.loads(line) for line in (tmp_path / "heard").read_text().splitlines()]
    assert [(one["rig"], one["conclusion"], one["session"]) for one in heard] == [
        ("small", "drifted", "abc"),
        ("small", "rejected", "def"),
    ]


def test_what_is_damaged_is_logged_and_holds_up_no_other(tmp_path, caplog):
    for entry in (DRIFT, LATER):
        leave_alert(tmp_path / ALERTS, "small", entry)
    first, _ = sorted((tmp_path / ALERTS).iterdir())
    first.write_text(first.read_text()[:30])
    run_alerts(command(tmp_path / "heard"), tmp_path / ALERTS)
    (heard,) = (json.loads(line) for line in (tmp_path / "heard").read_text().splitlines())
    assert heard["conclusion"] == "rejected"
    assert "must be JSON" in caplog.records[0].fault
    assert not any((tmp_path / ALERTS).iterdir())


def test_a_command_that_is_interrupted_runs_again_and_one_that_fails_is_logged(tmp_path, monkeypatch, caplog):
    class Killed(BaseException):
        pass

    def killed(*_: Any) -> None:
        raise Killed

    leave_alert(tmp_path / ALERTS, "small", DRIFT)
    with monkeypatch.context() as patch:
        patch.setattr(alerts, "run_command", killed)
        with pytest.raises(Killed):
            run_alerts("x", tmp_path / ALERTS)
    with caplog.at_level(logging.ERROR, "coilcal.service"):
        run_alerts("false", tmp_path / ALERTS)
    (record,) = caplog.records
    assert "ended with exit code 1" in record.__dict__["fault"]
    assert list((tmp_path / ALERTS).iterdir()) == []


@pytest.mark.parametrize("has_alerts", [True, False])
def test_a_recalibration_leaves_a_conclusion_that_calls_for_action(tmp_path, small_session, has_alerts):
    """Fields in millitesla that say they are in tesla are rejected before any fit."""
    readings = small_session.observations
    wrong = replace(readings, field_sensor_T=1e3 * readings.field_sensor_T)
    Session(small_session.rig, wrong, "wrong unit").save(tmp_path / "abc.zarr")
    folder = tmp_path / "jobs" / "j"
    folder.mkdir(parents=True)
    content = {"options": {"seed": 0, "settings": QUICK}, "registry": str(tmp_path / "registry"), "rig": None}
    job = AssignedJob({**content, "has_alerts": has_alerts}, folder, tmp_path / "abc.zarr", lambda *_: None)
    result = tasks.recalibrate_job(job)
    (entry,) = Registry(tmp_path / "registry").entries()
    assert result["conclusion"] == entry.conclusion == "rejected"
    left = [json.loads(path.read_text()) for path in (tmp_path / ALERTS).glob("*.json")]
    assert [(one["rig"], one["session"], one["reason"]) for one in left] == (
        [("small", "abc", entry.reason)] if has_alerts else []
    )


def test_a_command_comes_from_the_settings_only(idle):
    assert (
        load_settings(environment={"COILCAL_SERVE_ALERT_COMMAND": "mail -s coils"}).alert_command
        == "mail -s coils"
    )
    for wrong in ("mail 'x", " "):
        with pytest.raises(InvalidInput, match="alert_command must be a command"):
            load_settings(environment={"COILCAL_SERVE_ALERT_COMMAND": wrong})
    client = idle(alert_command="secret-command")
    assert client.app.state.core.settings.alert_command == "secret-command"  # type: ignore[attr-defined]
    schema = client.get("/v1/openapi.json").text
    assert "alert_command" not in schema
    assert "secret-command" not in schema + client.get("/v1/state").text
