"""Faults as sentences, and options of every command."""

from __future__ import annotations

import json
import logging

import click
import pytest
from click.testing import CliRunner

from estimator.calibration.calibrate import Stage
from estimator.cli.main import main
from estimator.cli.named import named_number, named_numbers
from estimator.cli.output import CoilcalCommand, explained_errors
from estimator.cli.progress import Reporter
from estimator.errors import CorruptStore, InvalidInput
from tests.estimator.cli.conftest import run


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
def test_a_fault_becomes_a_sentence_and_an_exit_code(capsys, fault, code, sentence):
    with pytest.raises(SystemExit) as caught, explained_errors():
        raise fault
    assert caught.value.code == code
    assert capsys.readouterr() == ("", sentence)


def test_a_program_gets_the_fault_as_json_too(capsys):
    with pytest.raises(SystemExit), explained_errors(as_json=True):
        raise CorruptStore("c is damaged")
    shown = capsys.readouterr()
    assert json.loads(shown.out) == {"error": "c is damaged", "exit_code": 3}
    assert shown.err == "coilcal: c is damaged\n"


@pytest.mark.parametrize("fault", [BrokenPipeError(), ZeroDivisionError()])
def test_a_closed_pipe_and_a_bug_are_not_explained_away(fault):
    with pytest.raises(type(fault)), explained_errors():
        raise fault


def test_options_name_numbers():
    assert named_number(["coil1=3", "coil2=-2e-3"], "--current") == {"coil1": 3.0, "coil2": -2e-3}
    assert named_numbers("arm1=0,0,0.1,0,0,-1", "--motion", 6) == ("arm1", [0.0, 0.0, 0.1, 0.0, 0.0, -1.0])


def test_quiet_keeps_progress_back_and_verbose_logs(tmp_path):
    @click.command(cls=CoilcalCommand)
    def long_command() -> None:
        with Reporter() as reporter:
            reporter.calibration(Stage("point estimate"))
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


def test_every_command_can_be_quiet():
    for name, command in main.commands.items():
        if isinstance(command, CoilcalCommand):
            assert {"--quiet", "--verbose"} <= {o for p in command.params for o in p.opts}, name
