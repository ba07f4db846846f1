"""What a worker does for a job, in the job's folder: every step can be made again after a kill, and ends with the same files."""

from __future__ import annotations

import fcntl
import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from estimator.errors import CoilcalError, CorruptStore
from estimator.json_files import read_json
from estimator.service.tasks import TASKS, AssignedJob

JOB, RESULT, PROGRESS, LOCK = "job.json", "result.json", "progress.jsonl", "lock"
PROGRESS_EVERY_S = 0.2

STOP = "stop"  # a file that says that the job must end, for workers that cannot be replaced


class Stopped(BaseException):
    """The job was cancelled, or its time is over; no `except Exception` on the way holds this up."""


def run_job(folder: str, session: str) -> None:
    """Do the job of a folder, or what is left of it, and write `result.json`, which marks it as done.

    Args:
        folder: The job's folder with `job.json`.
        session: Folder of its session.
    """
    torch.set_num_threads(1)
    path = Path(folder)
    with _only_worker(path):
        if (path / RESULT).exists() or (path / STOP).exists():
            return
        content = read_json(path / JOB, fault=CorruptStore)
        job = AssignedJob(content, path, Path(session), _Progress(path).tell)
        try:
            result = {"state": "done", "fault": None, **TASKS[content["kind"]].work(job)}
        except Stopped:
            return
        except CoilcalError as error:
            result = {"state": "failed", "fault": str(error)}
        job.write(RESULT, result)


class _Progress:
    """Appends lines of progress to a file; new numbers of the same kind come five times a second at most."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._last_kind, self._last_s = folder, tuple[str, ...](), 0.0

    def tell(self, words: str, numbers: Mapping[str, Any]) -> None:
        """Append a line, or end a job that must end."""
        if (self._folder / STOP).exists():
            raise Stopped
        kind, now_s = (words, *numbers), time.monotonic()
        if kind == self._last_kind and now_s - self._last_s < PROGRESS_EVERY_S:
            return
        self._last_kind, self._last_s = kind, now_s
        line = {"time_s": round(time.time(), 3), "words": words, **_finite(numbers)}
        with (self._folder / PROGRESS).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def _finite(numbers: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and value - value != 0.0 else value
        for name, value in numbers.items()
    }


@contextmanager
def _only_worker(folder: Path) -> Iterator[None]:
    """Wait for another worker at the same job, such as one that has not noticed yet that its service was killed."""
    with (folder / LOCK).open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
