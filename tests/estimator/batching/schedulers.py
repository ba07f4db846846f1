"""A Dask scheduler and a worker in processes of their own, to be killed."""

from __future__ import annotations

import os
import socket
import subprocess
import sys


def free_address() -> str:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{free.getsockname()[1]}"


def started(address: str) -> list[subprocess.Popen[bytes]]:
    """A scheduler and one worker."""
    dask = [
        sys.executable,
        "-m",
        "distributed.cli.dask_scheduler",
        "--port",
        address.rpartition(":")[2],
        "--dashboard-address",
        "127.0.0.1:0",
    ]
    worker = [
        sys.executable,
        "-m",
        "distributed.cli.dask_worker",
        address,
        "--nthreads",
        "1",
        "--no-nanny",
        "--no-dashboard",
    ]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    return [subprocess.Popen(command, **quiet) for command in (dask, worker)]


def stop(processes: list[subprocess.Popen[bytes]]) -> None:
    for process in processes:
        process.kill()
        process.wait()
