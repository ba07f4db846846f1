"""What takes long to make is made once in a run of the tests, not by each of its workers."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest
from filelock import FileLock

Made = TypeVar("Made")


def once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], Made]) -> Made:
    """What `make` returned to the worker that asked first; the others wait for it and read a copy.

    Args:
        factory: Of this worker.
        name: No two things of a run may share it.
        make: Is given a new folder to write into, which stays until the run ends. What it returns must be picklable.
    """
    of_run = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        of_run = of_run.parent  # each worker has its own folder in that of the run
    folder, kept = of_run / name, of_run / f"{name}.pickle"
    with FileLock(of_run / f"{name}.lock"):
        if not kept.exists():
            folder.mkdir()
            kept.write_bytes(pickle.dumps(make(folder)))
    made: Made = pickle.loads(kept.read_bytes())
    return made
