"""Carries out commands of `coilcal --via local`, each in a fork of a process that has loaded the libraries: `coilcal serve` starts it.

Two such processes wait, each at a socket of its own: for commands on NumPy, and for those that take derivatives. Each loads its libraries
for the first command, takes no other thread, and computes nothing, so that a fork of it is as a new process.
A fork for each command tells its caller what is loaded, starts the command in a fork of its own, and waits for both: it hands signals on,
interrupts a command whose caller is gone, and says how it ended. It ends with its command, not with `coilcal serve`.
"""

from __future__ import annotations

import fcntl
import gc
import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from stat import S_ISSOCK
from typing import Any

from estimator.cli.local import KINDS
from estimator.cli.local_command import STREAMS, end_with, run, wait
from estimator.cli.local_socket import (
    address,
    circumstances,
    folder_path,
    is_own,
    opened_folder,
    receive_request,
    send_line,
)
from estimator.errors import InvalidInput
from estimator.tensors import compute_on_numpy

Request = tuple[dict[str, Any], list[int]]
PROGRAM = (
    "import json, sys; _, kind, path = sys.argv; sys.path[:] = json.loads(path); "
    "from estimator.cli.local_server import main; main(kind)"
)
REFUSED = "coilcal: commands of --via local cannot be carried out:"
EXIT_TAKEN = 75  # another process has the socket
REQUEST_S = 10.0  # in which a caller says what it wants
BACKLOG = 64
N_DESCRIPTORS = len(STREAMS) + 1  # and the current folder
ALLOCATORS = ("jemalloc_bg_thd",)  # a thread of pyarrow, which looks after forks itself
LIBRARIES = (
    *("estimator.cli.contents", "estimator.cli.instruments", "estimator.cli.main", "estimator.cli.progress"),
    *("estimator.cli.proposal", "estimator.cli.understood", "estimator.calibration.notes"),
    *("estimator.calibration.result", "estimator.export.cpp_header", "estimator.model.hide"),
    *("estimator.model.simulate", "estimator.model.unit_gate", "estimator.readings.digits"),
    *("estimator.rig_files.unlikely", "estimator.store.importers.checked"),
    *("estimator.store.importers.forms.understand", "numpy.ma", "numpy.random", "zarr.storage"),
)
WITH_TORCH = (
    *("arviz_stats.base", "emcee", "estimator.calibration.calibrate", "estimator.calibration.report"),
    *("estimator.diagnosis.diagnose", "estimator.diagnosis.posterior", "estimator.diagnosis.report"),
    *("numba", "scipy.stats", "sympy"),
)


@contextmanager
def carrying_out() -> Iterator[list[subprocess.Popen[bytes]]]:
    """Processes that carry out commands as long as the block lasts, or until this process ends in any way."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM, kind, json.dumps(sys.path)],
            stdin=subprocess.PIPE,
            start_new_session=True,
            cwd="/",  # or a module there would be taken for one of Python
        )
        for kind in KINDS
    ]
    try:
        yield processes
    finally:
        for process in processes:
            process.communicate()  # ends its input


def main(kind: str) -> None:
    """Wait for commands until standard input ends."""
    os.environ["OMP_NUM_THREADS"] = "1"
    os.umask(0o77)
    try:
        os.close(os.pidfd_open(os.getpid()))  # which an old system does not have
        folder = opened_folder(is_made=True)
        lock = os.open(f"{kind}.lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600, dir_fd=folder)
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        listener = _bound(folder, kind)
    except BlockingIOError:
        sys.exit(EXIT_TAKEN)
    except (InvalidInput, OSError) as error:
        sys.exit(f"{REFUSED} {error}")
    request = _Waiting(kind, listener, (folder, lock)).next_request()
    if request is not None:
        run(
            import_module("estimator.cli.main").main, *request
        )  # which serves, too: a circle of imports otherwise
    else:
        os.unlink(kind, dir_fd=folder)


def _bound(folder: int, kind: str) -> socket.socket:
    """The socket of a kind, in place of the one that an ended process left."""
    with suppress(FileNotFoundError):
        about = os.stat(kind, dir_fd=folder, follow_symlinks=False)
        if not S_ISSOCK(about.st_mode) or about.st_uid != os.geteuid():
            raise InvalidInput(f"{folder_path() / kind} must be a socket of yours")
        os.unlink(kind, dir_fd=folder)
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(address(folder, kind))
    listener.listen(BACKLOG)
    return listener


class _Waiting:
    """Waits for commands at a socket.

    Args:
        kind: Of commands.
        listener: The socket.
        descriptors: What else its forks close. A lock is free when no process has it open.
    """

    def __init__(self, kind: str, listener: socket.socket, descriptors: tuple[int, ...]) -> None:
        self._kind, self._listener, self._descriptors = kind, listener, descriptors
        self._circumstances, self._files = circumstances(), dict[str, tuple[int, ...]]()
        self._is_loaded = False

    def next_request(self) -> Request | None:
        """In a fork: what it has to carry out. In this process: None, at the end of its input."""
        while True:
            ready, _, _ = select.select([self._listener, sys.stdin], [], [])
            if sys.stdin in ready:
                return None
            with suppress(OSError):  # of the system, which may refuse another process
                connection, _ = self._listener.accept()
                with connection:
                    self._load()
                    if os.fork() == 0:
                        return self._of_fork(connection)

    def _load(self) -> None:
        """Load the libraries, once."""
        if self._is_loaded:
            return
        if self._kind == "numpy":
            compute_on_numpy()
        for name in (*LIBRARIES, *(WITH_TORCH if self._kind == "torch" else ())):
            import_module(name)
        if self._kind == "torch":
            _read_machine_code()
        threads = [path.read_text().strip() for path in Path("/proc/self/task").glob("*/comm")]
        if len([name for name in threads if name not in ALLOCATORS]) > 1:
            sys.exit(f"{REFUSED} a library has started a thread, which a fork would lack")
        if self._kind == "numpy" and "torch" in sys.modules:
            sys.exit(f"{REFUSED} a plug-in has loaded torch")
        paths = [
            module.__file__ for module in list(sys.modules.values()) if getattr(module, "__file__", None)
        ]
        paths += [path for path in sys.path if path.endswith("-packages")]  # what is installed changes them
        self._files = {path: _state(path) for path in map(str, paths)}
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # forks that ended are not waited for
        gc.collect()
        gc.freeze()  # a collection in a fork would copy all of it
        self._is_loaded = True

    def _of_fork(self, connection: socket.socket) -> Request:
        """Start a command and wait for it: returns in the process of the command alone."""
        try:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            self._listener.close()
            for descriptor in self._descriptors:
                os.close(descriptor)
            if not is_own(connection):
                os._exit(1)
            changed = any(_state(path) != state for path, state in self._files.items())
            connection.settimeout(REQUEST_S)
            send_line(connection, {**self._circumstances, "changed": changed})
            request, descriptors = receive_request(connection, N_DESCRIPTORS)
            parent, command = os.getpid(), os.fork()
            if command == 0:
                end_with(parent)
                return request, descriptors
            os.setpgid(command, command)
            for descriptor in descriptors:
                os.close(descriptor)
            wait(connection, command)
        except (OSError, ValueError):  # the caller is gone
            pass
        os._exit(0)


def _read_machine_code() -> None:
    """Let numba read what a calibration needs of it, at its first call."""
    import torch

    from estimator.field.kernel import field_and_slopes, slopes_of_loops, sum_of_loops

    points_m, loops = torch.ones(1, 1, 3, dtype=torch.float64), torch.ones(1, 1, dtype=torch.float64)
    sum_of_loops(points_m, loops, loops, loops, 1)
    slopes_of_loops(points_m, loops, loops, 1)
    field_and_slopes(points_m, loops.expand(2, 1, 2, 1))


def _state(path: str) -> tuple[int, ...]:
    """What changes with a file."""
    try:
        about = Path(path).stat()
    except OSError:
        return ()
    return about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns, about.st_ctime_ns
