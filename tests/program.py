"""`coilcal` and pieces of Python as processes of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PYTHON = sys.executable
PROGRAM = [PYTHON, "-c", "from estimator.cli.main import main; main(prog_name='coilcal')"]


def finished(*call: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """A process that has come to its end, with what it printed; in the root of the repository unless said otherwise."""
    usual: dict[str, Any] = {"cwd": ROOT, "capture_output": True, "text": True}
    return subprocess.run([*map(str, call)], check=False, **{**usual, **more})


def launched(*call: object, **more: Any) -> subprocess.Popen[str]:
    """A process that runs, whose output is read."""
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([*map(str, call)], **{"cwd": ROOT, "text": True, **pipes, **more})
