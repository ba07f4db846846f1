"""Progress on a terminal and in a pipe, and faults as sentences."""

from __future__ import annotations

import io
import json
import logging
import sys
import time
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from estimator.calibration.calibrate import Stage
from estimator.cli.main import main
from estimator.cli.output import CoilcalCommand, explained_errors, named_number, named_numbers
from estimator.cli.progress import Reporter, TimeLeft
from estimator.errors import CorruptStore, InvalidInput
from estimator.inference.ensemble import Progress
from estimator.inference.laplace import OpenDirection
from tests.estimator.cli.conftest import run


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


STAGES = (
    Stage("point estimate"),
    Stage("Laplace", open_directions=(OpenDirection("coil1 thickness", 3.0, {"coil1 thickness": 1.0}),)),
    Stage("sampling", Progress(50, 1000, 120.0, 2000.0, 1.0123)),
    Stage("sampling", Progress(100, 1000, 250.0, 2000.0, 1.0071)),
)
WORDS = (
    "point estimate",
    "not determined by the data: coil1 thickness",
    "step 100, effective samples 250 of 2000, R-hat 1.0071",
)


def report(monkeypatch: pytest.MonkeyPatch, stream: io.StringIO) -> str:
    monkeypatch.setattr(sys, "stderr", stream)
    with Reporter() as reporter:
        for stage in STAGES:
            reporter.calibration(stage)
    return stream.getvalue()


def test_a_pipe_gets_every_line_once_and_plainly(monkeypatch: pytest.MonkeyPatch) -> None:
    assert report(monkeypatch, io.StringIO()).splitlines() == [
        "point estimate",
        "Laplace",
        "  not determined by the data: coil1 thickness",
        "sampling",
        "  step 50, effective samples 120 of 2000, R-hat 1.0123",
        "  step 100, effective samples 250 of 2000, R-hat 1.0071",
    ]


def test_a_terminal_gets_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    shown = report(monkeypatch, Terminal())
    assert "\x1b[" in shown
    assert all(word in shown for word in WORDS[:2])


@pytest.mark.parametrize(
    ("fault", "code", "sentence"),
    [
        (InvalidInput("a must be b"), 2, "coilcal: a must be b\n"),
        (CorruptStore("c is damaged"), 3, "coilcal: c is damaged\n"),
        (InvalidInput("\x1b[2Jd\r\x9b"), 2, "coilcal: \\x1b[2Jd\\r\\x9b\n"),
        (
            PermissionError(13, "Permission denied", "/x"),
            2,
            "coilcal: /x must be readable and writable: Permission denied\n",
        ),
    ],
)
def test_a_fault_becomes_a_sentence_and_an_exit_code(
    capsys: pytest.CaptureFixture[str], fault: Exception, code: int, sentence: str
) -> None:
    with pytest.raises(SystemExit) as caught, explained_errors():
        raise fault
    assert caught.value.code == code
    assert capsys.readouterr() == ("", sentence)


def test_a_program_gets_the_fault_as_json_too(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit), explained_errors(as_json=True):
        raise CorruptStore("c is damaged")
    shown = capsys.readouterr()
    assert json.loads(shown.out) == {"error": "c is damaged", "exit_code": 3}
    assert shown.err == "coilcal: c is damaged\n"


@pytest.mark.parametrize("fault", [BrokenPipeError(), ZeroDivisionError()])
def test_a_closed_pipe_and_a_bug_are_not_explained_away(fault: Exception) -> None:
    with pytest.raises(type(fault)), explained_errors():
        raise fault


def test_options_name_numbers() -> None:
    assert named_number(["coil1=3", "coil2=-2e-3"], "--current") == {"coil1": 3.0, "coil2": -2e-3}
    assert named_numbers("arm1=0,0,0.1,0,0,-1", "--motion", 6) == ("arm1", [0.0, 0.0, 0.1, 0.0, 0.0, -1.0])


@pytest.mark.parametrize("text", ["coil1", "coil1=", "coil1=3 A", "coil1=1,2", "coil1=inf", "3", ""])
def test_what_is_no_named_number_is_refused(text: str) -> None:
    with pytest.raises(InvalidInput, match=r"--current must look like NAME=1\.0; received"):
        named_number([text], "--current")


def test_the_time_left_follows_from_what_was_done_since_the_beginning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[0])
    left = TimeLeft()
    assert left.words(50.0, 250.0) == ""
    now_s[0] += 10.0
    assert left.words(100.0, 250.0) == ", about 30 s left"
    assert left.words(250.0, 250.0) == ""
    assert left.words(0.0, 100.0) == ""  # something new
    now_s[0] += 1.0
    assert left.words(1.0, 100.0) == ", about 1 min 39 s left"
    assert left.words(99.9, 100.0) == ""


def test_quiet_keeps_progress_back_and_verbose_logs(tmp_path: Path) -> None:
    @click.command(cls=CoilcalCommand)
    def long_command() -> None:
        with Reporter() as reporter:
            for stage in STAGES:
                reporter.calibration(stage)
        click.echo("done")

    loud, quiet = (CliRunner().invoke(long_command, options) for options in ([], ["--quiet"]))
    assert loud.stderr.splitlines()[0] == "point estimate"
    assert (quiet.exit_code, quiet.stdout, quiet.stderr) == (0, "done\n", "")
    faulty = run("show", tmp_path / "nothing", "--quiet")
    assert "path must exist" in faulty.stderr
    logger = logging.getLogger("estimator")
    before = logger.level
    try:
        assert run("explain", "axis_gain", "--verbose").exit_code == 0
        assert logger.level == logging.DEBUG
    finally:
        logger.setLevel(before)


def test_every_command_can_be_quiet() -> None:
    for name, command in main.commands.items():
        if isinstance(command, CoilcalCommand):
            assert {"--quiet", "--verbose"} <= {o for p in command.params for o in p.opts}, name
