"""A service in a process of its own, for scripts that ask it much or kill it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = [sys.executable, "-c", "from estimator.cli.main import main; main(prog_name='coilcal')"]


class ServiceProcess:
    """A service with one worker.

    Args:
        data: Its data folder; its log is beside it.
        port: Its port; 0 takes a free one.
    """

    def __init__(self, data: Path, port: int = 0) -> None:
        call = ["serve", "--data", str(data), "--port", str(port), "--workers", "1"]
        with data.with_suffix(".log").open("ab") as log:
            self.process = subprocess.Popen(
                [*PROGRAM, *call],
                stdout=subprocess.PIPE,
                stderr=log,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )
        assert self.process.stdout is not None
        line = self.process.stdout.readline().decode()
        if " at http" not in line:
            raise RuntimeError(
                f"the service must start; {data.with_suffix('.log').read_text(encoding='utf-8')[-2000:]}"
            )
        self.url = line.split()[-1]
        self.port = int(self.url.rpartition(":")[2])

    def kill(self) -> None:
        """As `kill -9` does."""
        self.process.kill()
        self.process.communicate()

    def end(self) -> None:
        """As `systemctl stop` does."""
        self.process.terminate()
        self.process.communicate(timeout=120)
