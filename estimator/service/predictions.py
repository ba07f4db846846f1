"""Predictions: those that arrive within a few milliseconds for one calibration run as one torch batch, on a thread of their own."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue

from torch import Tensor

from estimator.calibration.predictions import Question, Wanted, answers
from estimator.calibration.result import Calibration
from estimator.service.concurrency import RefusingLimit

WINDOW_S = 0.002  # a question waits so long for others, if none is there
BLOCK = 2_000  # points of a batch; with 400 draws they take 20 MB, and small questions pass between the blocks of a large one
RETRY_AFTER_S = 1

Answer = dict[str, Tensor]


@dataclass(frozen=True)
class _Waiting:
    folder: Path
    question: Question
    wanted: Wanted
    answer: Future[Answer] = field(default_factory=Future)


class Predictor:
    """Answers questions about calibrations.

    Args:
        load: Reads a calibration of a folder, from memory if it is there.
        most_waiting: Requests that may be at work or wait: each counts once for `limit`, however many blocks it asks for.
    """

    def __init__(self, load: Callable[[Path], Calibration], most_waiting: int) -> None:
        self._load = load
        self.limit = RefusingLimit("predictions", most_waiting, retry_after_s=RETRY_AFTER_S)
        self._queue: SimpleQueue[_Waiting | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="coilcal predictions", daemon=True)
        self._thread.start()

    async def ask(self, folder: Path, question: Question, wanted: Wanted) -> Answer:
        """The answer to a question of at most `BLOCK` points.

        Raises:
            InvalidInput: As `estimator.calibration.predictions.answers`.
            CorruptStore: The calibration is damaged.
        """
        waiting = _Waiting(folder, question, wanted)
        self._queue.put(waiting)
        return await asyncio.wrap_future(waiting.answer)

    def close(self) -> None:
        """Answer what waits, and end."""
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (first := self._queue.get()) is not None:
            if self._queue.empty():
                time.sleep(WINDOW_S)
            waiting: list[_Waiting] = [first]
            while not self._queue.empty():
                another = self._queue.get()  # no other thread takes from the queue
                if another is None:
                    self._queue.put(None)  # for the outer loop
                    break
                waiting.append(another)
            for batch in _batches([each for each in waiting if each.answer.set_running_or_notify_cancel()]):
                self._answer(batch)

    def _answer(self, batch: Sequence[_Waiting]) -> None:
        try:
            answered = answers(
                self._load(batch[0].folder), [each.question for each in batch], batch[0].wanted
            )
        except Exception as error:
            if len(batch) == 1:
                batch[0].answer.set_exception(error)
                return
            for each in batch:  # the fault of one is not the others'
                self._answer([each])
            return
        for each, answer in zip(batch, answered, strict=True):
            each.answer.set_result(answer)


def _batches(waiting: Sequence[_Waiting]) -> list[list[_Waiting]]:
    """Waiting questions in batches that can run together: of one calibration, for the same quantities, of `BLOCK` points at most."""
    batches: list[list[_Waiting]] = []
    open_batch: dict[tuple[Path, Wanted], list[_Waiting]] = {}
    n_points: dict[tuple[Path, Wanted], int] = {}
    for each in waiting:
        key, n = (each.folder, each.wanted), len(each.question.points_m)
        if key not in open_batch or n_points[key] + n > BLOCK:
            open_batch[key], n_points[key] = [], 0
            batches.append(open_batch[key])
        open_batch[key].append(each)
        n_points[key] += n
    return batches
