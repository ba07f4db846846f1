"""`coilcal recalibrate`: exit codes, alerts, rollback and the running service; what it concludes is tested with the job itself."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from click.testing import CliRunner, Result

from estimator.cli.main import main
from estimator.cli.schedule import keep_running
from estimator.readings.observations import Observations
from estimator.recalibration import recalibrate as recalibration
from estimator.recalibration.log import Entry
from estimator.recalibration.registry import Registry
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from tests.estimator.conftest import TWO_COILS
from tests.program import PROGRAM, launched


@pytest.fixture
def rig_file(rig_text: str, tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text, encoding="utf-8")
    return path


@pytest.fixture
def concluding(monkeypatch: pytest.MonkeyPatch, rig_file: Path, tmp_path: Path) -> Callable[..., Result]:
    """The command with a job that comes to given conclusions."""

    def run(conclusions: tuple[str | Entry, ...], *options: str) -> Result:
        def job(*_: object, on_entry: Callable[[Entry], None], **__: object) -> list[Entry]:
            entries = [
                Entry(c, f"because of {c}", "a.zarr", taken="2026-01-01T00:00:00+00:00")
                if isinstance(c, str)
                else c
                for c in conclusions
            ]
            for entry in entries:
                on_entry(entry)
            return entries

        monkeypatch.setattr(recalibration, "recalibrate", job)
        call = ["--rig", rig_file, "--inbox", tmp_path, "--registry", tmp_path / "r", *options]
        return CliRunner().invoke(main, ["recalibrate", *map(str, call)])

    return run


@pytest.mark.parametrize(
    ("conclusions", "code"),
    [
        ((), 0),
        (("unchanged", "updated"), 0),
        (("drifted", "unchanged"), 10),
        (("rejected",), 11),
        (("rejected", "drifted"), 10),
    ],
)
def test_exit_code_tells_drift_and_rejection(concluding, conclusions, code):
    result = concluding(conclusions)
    assert result.exit_code == code
    for conclusion in conclusions:
        assert f"2026-01-01T00:00  a.zarr  {conclusion}: because of {conclusion}" in result.stdout


def test_a_calibration_that_did_not_converge_has_an_exit_code_and_an_alert_of_its_own(concluding, tmp_path):
    unsure = Entry("unchanged", "it did not converge", "a.zarr", checks={"is_successor_converged": False})
    assert concluding((unsure,), "--alert-command", f"tee {tmp_path / 'alert.json'}").exit_code == 4
    assert json.loads((tmp_path / "alert.json").read_text())["reason"] == "it did not converge"


def test_what_the_system_refuses_does_not_end_the_running_service(capsys):
    calls: list[int] = []

    def job() -> None:
        calls.append(1)
        if len(calls) == 1:
            raise PermissionError(13, "Permission denied", "inbox")
        os.kill(os.getpid(), signal.SIGTERM)

    keep_running(job, 1.0)
    assert len(calls) == 2
    assert "Permission denied" in capsys.readouterr().err


def test_a_signal_just_after_a_run_ends_the_service_without_a_word_more(capsys, caplog):
    def job(after_s: float) -> None:
        signal.signal(signal.SIGALRM, signal.getsignal(signal.SIGTERM))  # an alarm comes to the microsecond
        signal.setitimer(signal.ITIMER_REAL, after_s)

    for n in range(1, 200):
        keep_running(partial(job, 1e-6 * n), 1.0)
        assert capsys.readouterr().err == "coilcal: stopped\n"
    assert not caplog.records


def test_json_holds_every_conclusion_in_one_object(concluding):
    result = concluding(("unchanged", "rejected"), "--json")
    assert [entry["conclusion"] for entry in json.loads(result.stdout)["added"]] == ["unchanged", "rejected"]


def test_alerts_go_out_for_drifts_and_rejections_only_and_a_failing_one_is_not_fatal(concluding, tmp_path):
    program = "import sys; open(sys.argv[1], 'a').write(sys.stdin.read() + chr(10)); sys.exit(7)"
    kept = tmp_path / "alerts.jsonl"
    result = concluding(
        ("unchanged", "drifted", "updated", "rejected"),
        "--alert-command",
        f'{sys.executable} -c "{program}" {kept}',
    )
    assert result.exit_code == 10
    sent = [json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()]
    assert [message["conclusion"] for message in sent] == ["drifted", "rejected"]
    assert sent[0]["registry"] == str(tmp_path / "r")
    assert result.stderr.count("ended with exit code 7") == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "--rig and --inbox must be given"),
        (["--rollback", "1", "--every", "6h"], "--rollback must stand alone"),
        (["--rollback", "1"], "registry must be a folder that coilcal recalibrate has filled"),
        (["--rig", "RIG", "--inbox", ".", "--every", "often"], "--every must be a time such as"),
        (
            ["--rig", "RIG", "--inbox", ".", "--alert-webhook", "ftp://a"],
            "webhook must be an http or https address",
        ),
        (["--rig", "RIG", "--inbox", "nowhere"], "inbox must be a folder of sessions"),
    ],
)
def test_mistakes_of_the_call_are_one_sentence(
    options: list[str], words: str, rig_file: Path, tmp_path: Path
) -> None:
    options = [str(rig_file) if option == "RIG" else option for option in options]
    result = CliRunner().invoke(main, ["recalibrate", "--registry", str(tmp_path / "registry"), *options])
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_rollback_by_command(small_calibration, tmp_path):
    registry = Registry(tmp_path / "registry")
    with registry.writing():
        for name in "ab":
            registry.commit(Entry("updated", "", name, name, "2026-01-01T00:00:00+00:00"), small_calibration)
    result = CliRunner().invoke(main, ["recalibrate", "--registry", str(registry.folder), "--rollback", "1"])
    assert result.exit_code == 0
    assert result.stdout == "version 2 replaced by version 1 on request\n"
    assert registry.current == 1


def test_the_running_service_looks_again_and_ends_cleanly(rig_file, tmp_path):
    inbox = tmp_path / "inbox"
    inbox.mkdir()
    of_another = rig_from_text(TWO_COILS)
    still = {mover.name: torch.zeros(3, 6, dtype=torch.float64) for mover in of_another.movers}
    readings = Observations.of(torch.ones(3, 2).double(), still, torch.ones(3, 3).double() * 1e-3)
    Session(of_another, readings, "another rig", "2026-01-01T00:00:00+00:00").save(inbox / "first.zarr")
    call = ["--rig", rig_file, "--inbox", inbox, "--registry", tmp_path / "registry", "--every", "1s"]
    running = launched(*PROGRAM, "recalibrate", *call, "--json")
    assert running.stdout is not None

    def conclusions() -> list[Any]:
        assert running.stdout is not None
        return [entry["conclusion"] for entry in json.loads(running.stdout.readline())["added"]]

    assert conclusions() == ["rejected"]
    (inbox / "copied.zarr").mkdir()  # cannot be read yet
    others = readings.with_field(2.0 * readings.field_sensor_T)
    Session(of_another, others, "another rig", "2026-01-02T00:00:00+00:00").save(inbox / "second.zarr")
    deadline = time.monotonic() + 30.0
    found: list[Any] = []
    while not found and time.monotonic() < deadline:
        found = conclusions()
    assert found == ["rejected"]
    os.kill(running.pid, signal.SIGTERM)
    _, errors = running.communicate(timeout=30)
    assert running.returncode == 0
    *told, stopped = errors.splitlines()
    assert stopped == "coilcal: stopped"
    assert told[0] == "coilcal: judging first.zarr, session 1 of 1"
    waiting = [line for line in told if "is left for the next time" in line]
    assert len(waiting) == 1  # said once, however often it was looked at
    assert "copied.zarr is left for the next time: it cannot be read and changed" in waiting[0]
