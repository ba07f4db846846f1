"""Starts child processes that import what they run, and nothing of the program that starts them.

A spawned child of Python first imports the main file of its program again, for functions that are defined there. What that file imports
above its `__main__` guard, such as torch and matplotlib, would come before the supply that the child has to serve: half a minute on a
busy computer. What a child runs here is importable by name, so the main file is withheld.

A child with deadlines runs ahead of other processes, if the system permits it.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType

SPAWN: SpawnContext = multiprocessing.get_context("spawn")
"""Children start as fresh processes: a forked one would share the threads and locks of its parent."""

_ONE_AT_A_TIME = threading.Lock()


def start_without_main(process: SpawnProcess) -> None:
    """Start a process whose function and arguments are importable from modules other than the main file.

    Raises:
        PicklingError: One of them is defined in the main file.
    """
    with _ONE_AT_A_TIME:
        program = sys.modules["__main__"]
        # A module that has neither a file nor a spec that could be imported.
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            process.start()
        finally:
            sys.modules["__main__"] = program


@contextmanager
def deaf_to_the_terminal() -> Iterator[None]:
    """Let processes that are started in the block get neither Ctrl-C nor the end of their terminal (SIGHUP), from their first instant on.

    Signals that a thread holds back are held back for ever in the processes that it starts. A child that only asks for this once it runs
    would be killed by a second Ctrl-C while it starts to switch a supply off.
    """
    resource_tracker.ensure_running()  # which, where it starts its own process, lets signals through
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_LOG = logging.getLogger(__name__)


def run_ahead() -> None:
    """Request the lowest real-time priority: ahead of every ordinary process, behind all other real-time ones.

    An arm stops if its watchdog was not kicked for 0.2 s, and an ordinary process may wait that long on a busy computer. The process must
    sleep in each of its loops. Permission is `CAP_SYS_NICE` or a limit `rtprio` (man 7 sched). Without it the priority stays as it was,
    and an arm may stop needlessly.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR)))
    except OSError as error:
        _LOG.info("process %d runs at ordinary priority: %s", os.getpid(), error)
