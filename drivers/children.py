"""Starts child processes that import what they run, and nothing of the program that starts them.

A spawned child of Python first imports the main file of its program again, for functions that are defined there. What that file imports
above its `__main__` guard, such as torch and matplotlib, would come before the supply that the child has to serve: half a minute on a
busy computer. What a child runs here is importable by name, so the main file is withheld.
"""

from __future__ import annotations

import multiprocessing
import sys
import threading
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
