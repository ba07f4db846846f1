"""`coilcal` and pieces of Python as processes of their own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PYTHON = sys.executable
PROGRAM = [PYTHON, "-c", "from estimator.cli.main import main; main(prog_name='coilcal')"]
_LAUNCHED: list[subprocess.Popen[str]] = []


def finished(*call: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """A process that has come to its end, with what it printed; in the root of the repository unless said otherwise."""
    usual: dict[str, Any] = {"cwd": ROOT, "capture_output": True, "text": True}
    return subprocess.run([*map(str, call)], check=False, **{**usual, **more})


def launched(*call: object, **more: Any) -> subprocess.Popen[str]:
    """A process that runs, whose output is read."""
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    _LAUNCHED.append(subprocess.Popen([*map(str, call)], **{"cwd": ROOT, "text": True, **pipes, **more}))
    return _LAUNCHED[-1]


@contextmanager
def programs_end() -> Iterator[None]:
    """Kill what was launched in the block and still runs at its end, and close its pipes.

    A test that fails, and is tried again, waits for its programs no more; another test would fail for the pipes that they leave open.
    """
    n_before = len(_LAUNCHED)
    try:
        yield
    finally:
        for program in _LAUNCHED[n_before:]:
            program.kill()
            for pipe in filter(None, (program.stdin, program.stdout, program.stderr)):
                pipe.close()
            program.wait()
        del _LAUNCHED[n_before:]
