"""`coilcal recalibrate`: exit codes, alerts, rollback and the running service; what it concludes is tested with the job itself."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from estimator.calibration import Calibration
from estimator.cli import recalibrate as command
from estimator.cli.main import main
from estimator.registry import Entry, Registry

ROOT = Path(__file__).parents[3]
PROGRAM = [sys.executable, "-c", "from estimator.cli.main import main; main(prog_name='coilcal')"]


@pytest.fixture
def rig_file(rig_text: str, tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(rig_text, encoding="utf-8")
    return path


@pytest.fixture
def concluding(monkeypatch: pytest.MonkeyPatch, rig_file: Path, tmp_path: Path) -> Callable[..., Result]:
    """The command with a job that comes to given conclusions."""

    def run(conclusions: tuple[str, ...], *options: str) -> Result:
        def job(*_: object, on_entry: Callable[[Entry], None], **__: object) -> list[Entry]:
            entries = [
                Entry(c, f"because of {c}", "a.zarr", taken="2026-01-01T00:00:00+00:00") for c in conclusions
            ]
            for entry in entries:
                on_entry(entry)
            return entries

        monkeypatch.setattr(command, "recalibrate", job)
        call = [
            "recalibrate",
            "--rig",
            str(rig_file),
            "--inbox",
            str(tmp_path),
            "--registry",
            str(tmp_path / "r"),
        ]
        return CliRunner().invoke(main, [*call, *options])

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
def test_exit_code_tells_drift_and_rejection(
    concluding: Callable[..., Result], conclusions: tuple[str, ...], code: int
) -> None:
    result = concluding(conclusions)
    assert result.exit_code == code
    for conclusion in conclusions:
        assert f"2026-01-01T00:00  a.zarr  {conclusion}: because of {conclusion}" in result.stdout


def test_help_tells_the_exit_codes() -> None:
    for call in ([], ["recalibrate"]):
        told = " ".join(CliRunner().invoke(main, [*call, "--help"]).stdout.split())
        assert "10 a drift was found" in told
        assert "11 a session was rejected" in told


def test_json_holds_every_conclusion_in_one_object(concluding: Callable[..., Result]) -> None:
    result = concluding(("unchanged", "rejected"), "--json")
    assert [entry["conclusion"] for entry in json.loads(result.stdout)["added"]] == ["unchanged", "rejected"]


def test_alerts_go_out_for_drifts_and_rejections_only_and_a_failing_one_is_not_fatal(
    concluding: Callable[..., Result], tmp_path: Path
) -> None:
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


def test_rollback_by_command(small_calibration: Calibration, tmp_path: Path) -> None:
    registry = Registry(tmp_path / "registry")
    with registry.writing():
        for name in "ab":
            registry.commit(Entry("updated", "", name, name, "2026-01-01T00:00:00+00:00"), small_calibration)
    result = CliRunner().invoke(main, ["recalibrate", "--registry", str(registry.folder), "--rollback", "1"])
    assert result.exit_code == 0
    assert result.stdout == "version 2 replaced by version 1 on request\n"
    assert registry.current == 1


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_running_service_looks_again_and_ends_cleanly(
    number: signal.Signals, rig_file: Path, tmp_path: Path
) -> None:
    inbox = tmp_path / "inbox"
    inbox.mkdir()
    (inbox / "first.zarr").mkdir()  # no session: rejected
    call = [
        "recalibrate",
        "--rig",
        rig_file,
        "--inbox",
        inbox,
        "--registry",
        tmp_path / "registry",
        "--every",
        "1s",
    ]
    running = subprocess.Popen(
        [*PROGRAM, *map(str, call), "--json"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert running.stdout is not None

    def conclusions() -> list[Any]:
        assert running.stdout is not None
        return [entry["conclusion"] for entry in json.loads(running.stdout.readline())["added"]]

    assert conclusions() == ["rejected"]
    (inbox / "second.zarr").mkdir()
    (inbox / "second.zarr" / "zarr.json").write_text("{}", encoding="utf-8")
    deadline = time.monotonic() + 30.0
    found: list[Any] = []
    while not found and time.monotonic() < deadline:
        found = conclusions()
    assert found == ["rejected"]
    os.kill(running.pid, number)
    _, errors = running.communicate(timeout=30)
    assert running.returncode == 0
    assert errors == "coilcal: stopped\n"
