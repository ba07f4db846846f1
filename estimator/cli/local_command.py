"""A command of `coilcal --via local` and the process that waits for it; see `local_server`."""

from __future__ import annotations

import ctypes
import os
import select
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Any

from estimator.cli.local import CARRIED_OUT, PASSED_ON
from estimator.cli.local_socket import send_line

STREAMS = ("stdin", "stdout", "stderr")
MOST_SIGNALS = 64  # taken at once
PR_SET_PDEATHSIG = 1  # of prctl


def end_with(parent: int) -> None:
    """Interrupt this process when its parent ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT)
    if os.getppid() != parent:
        signal.raise_signal(signal.SIGINT)


def wait(connection: socket.socket, command: int) -> None:
    """Wait for the end of a command and tell it; until then hand on the signals that its caller sends, each a byte."""
    connection.settimeout(None)
    ended = os.pidfd_open(command)
    waited_for: list[Any] = [connection, ended]
    while True:
        ready, _, _ = select.select(waited_for, [], [])
        if ended in ready:
            _, status = os.waitpid(command, 0)
            send_line(connection, status)
            return
        try:
            numbers = connection.recv(MOST_SIGNALS)
        except OSError:
            numbers = b""
        if not numbers:  # the caller was killed
            waited_for.remove(connection)
        for number in numbers or (signal.SIGINT, signal.SIGCONT):
            _hand_on(command, number)


def _hand_on(command: int, number: int) -> None:
    """Send a signal to a command, and to what it started where a terminal would; in a session without one, SIGTSTP does nothing."""
    with suppress(OSError):  # it may have ended
        if number in (signal.SIGTSTP, signal.SIGCONT):
            os.killpg(command, signal.SIGSTOP if number == signal.SIGTSTP else number)
        elif number in PASSED_ON:
            os.kill(command, number)


def run(command: Callable[..., object], request: dict[str, Any], descriptors: list[int]) -> None:
    """Run a command as its caller would.

    Args:
        command: The program.
        request, descriptors: Of the caller.
    """
    os.fchdir(descriptors[-1])
    for number, descriptor in enumerate(descriptors[:-1]):
        os.dup2(descriptor, number)
    for descriptor in descriptors:
        os.close(descriptor)
    os.umask(request["umask"])
    with suppress(OSError):  # cores that this process may not use
        os.sched_setaffinity(0, request["cores"])
    os.nice(max(0, request["nice"] - os.nice(0)))
    os.environ.clear()
    os.environ.update(request["variables"])
    time.tzset()
    tempfile.tempdir = None
    import_module("numpy.random").seed()  # whoever takes unseeded numbers gets others than the fork before
    sys.argv, sys.orig_argv = request["words"]
    for number, (name, (encoding, errors)) in enumerate(zip(STREAMS, request["streams"], strict=True)):
        mode, buffering = "w" if number else "r", 1 if number == 2 else -1  # as Python makes them
        stream = open(number, mode, buffering, encoding, errors, closefd=False)  # noqa: SIM115
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    command(args=request["arguments"], prog_name="coilcal", obj=CARRIED_OUT)
