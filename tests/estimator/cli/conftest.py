"""A folder where every command has run once, and a way to call commands that checks what holds for all of them."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner, Result

from estimator.cli.main import main
from tests.once import once

CONTROL_CHARACTERS = re.compile(r"[\x00-\x09\x0b-\x1f\x7f]")  # all but line feeds


def run(*arguments: object) -> Result:
    """Run a command; whatever it prints has no control characters, and nothing escapes as a traceback."""
    n_threads = torch.get_num_threads()
    try:
        result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    finally:
        torch.set_num_threads(n_threads)  # `--threads` is for the whole process
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert not CONTROL_CHARACTERS.search(result.stdout + result.stderr)
    return result


@dataclass(frozen=True)
class Printed:
    """What a command left behind."""

    exit_code: int
    stdout: str
    stderr: str


@pytest.fixture(scope="session")
def made(
    rig_text: str, plan_text: str, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Printed]]:
    """The workspace, and what the commands that made it printed."""

    def make(folder: Path) -> tuple[Path, dict[str, Printed]]:
        rig, plan, csv = folder / "rig.yaml", folder / "plan.yaml", folder / "readings.csv"
        rig.write_text(rig_text, encoding="utf-8")
        plan.write_text(plan_text, encoding="utf-8")
        calls: dict[str, list[object]] = {
            "simulate": [
                *("--rig", rig, "--plan", plan, "--seed", 1, "--set", "coil1.axial_loops=13"),
                *("--out", folder / "simulated.zarr", "--csv", csv, "--json"),
            ],
            "import": [csv, "--rig", rig, "--out", folder / "session.zarr"],
            "calibrate": [
                *(folder / "session.zarr", "--ess", 200, "--walkers", 16),
                *("--out", folder / "calibration", "--json"),
            ],
            "predict": [
                *(folder / "calibration", "--grid", "x_mm=-20:20:5", "--grid", "z_mm=10"),
                *("--current", "coil1=2", "--out", folder / "field.csv"),
            ],
        }
        results = {command: run(command, *call) for command, call in calls.items()}
        return folder, {c: Printed(r.exit_code, r.stdout, r.stderr) for c, r in results.items()}

    return once(tmp_path_factory, "workspace", make)


@pytest.fixture(scope="session")
def results(made: tuple[Path, dict[str, Printed]]) -> dict[str, Printed]:
    """What the commands that made the workspace printed."""
    return made[1]


@pytest.fixture(scope="session")
def workspace(made: tuple[Path, dict[str, Printed]]) -> Path:
    """A folder with rig.yaml, plan.yaml, simulated.zarr, readings.csv, session.zarr, calibration and field.csv; look, do not touch."""
    return made[0]


@pytest.fixture
def in_workspace(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The working directory is the workspace, and nothing in it may have changed afterwards."""
    monkeypatch.chdir(workspace)
    before = contents(workspace)
    yield workspace
    assert contents(workspace) == before


def contents(folder: Path) -> dict[str, bytes | None]:
    """Every path below a folder with the bytes of the files."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


@pytest.fixture(scope="session")
def simulate(workspace: Path) -> Callable[..., Result]:
    """`coilcal simulate` with the rig and plan of the workspace."""
    return partial(run, "simulate", "--rig", workspace / "rig.yaml", "--plan", workspace / "plan.yaml")


def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """A wide terminal in place of standard error; not a fixture, for pytest sets its own before the test begins."""
    made = io.StringIO()
    monkeypatch.setattr(made, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stderr", made)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "150")
    return made


def refused(result: Result, exit_code: int = 2) -> str:
    """The one sentence that a refused command prints."""
    assert (result.exit_code, result.stdout) == (exit_code, "")
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("coilcal: ")
    assert "Errno" not in result.stderr
    return result.stderr.removeprefix("coilcal: ").strip()
