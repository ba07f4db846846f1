"""The slow half of a live calibration: posterior and diagnosis of the readings so far, in a process of their own."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.pool import AsyncResult
from types import TracebackType

import torch

from estimator.calibrate import calibrate
from estimator.diagnose import diagnose
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.store.session import Session

QUICK = SamplerSettings(target_ess=400.0, largest_rhat=1.05, max_steps=3000)
FEWEST_READINGS = 15
GROWTH = 1.25  # of the session between two refreshments
NICENESS = 10


@dataclass(frozen=True)
class Refreshed:
    """Posterior and verdict about the first readings of a session.

    Attributes:
        n_readings: That it knows of, validation included.
        best: Values at the maximum.
        ci90: 90 % credible interval of each free parameter, from posterior draws.
        verdict: Of the diagnosis.
        causes: That were named, with what they cannot be told from.
        took_s: The work.
    """

    n_readings: int
    best: Mapping[str, float]
    ci90: Mapping[str, tuple[float, float]]
    verdict: str
    causes: tuple[str, ...]
    took_s: float

    @property
    def words(self) -> str:
        """The verdict as an operator reads it."""
        found = f": {', '.join(self.causes)}" if self.causes else ""
        return f"{self.verdict.replace('_', ' ')}{found} (after {self.n_readings} readings)"


def refreshed(session: Session, seed: int) -> Refreshed:
    """Posterior and verdict of a session.

    Raises:
        InvalidInput: The readings cannot support a fit yet.
    """
    begin_s = time.monotonic()
    calibration = calibrate(session, settings=QUICK, seed=seed)
    parameters = calibration.summary()["parameters"]
    diagnosis = diagnose(session, seed=seed).record()
    causes = tuple(
        " or ".join([_label(one), *(other["name"] for other in one["alternatives"])])
        for one in diagnosis["causes"]
    )
    return Refreshed(
        len(session.observations),
        dict(calibration.best),
        {name: (one["ci90"][0], one["ci90"][1]) for name, one in parameters.items()},
        str(diagnosis["verdict"]),
        causes,
        time.monotonic() - begin_s,
    )


class Background:
    """Refreshes one session after another, each begun when the one before is done; leaving its `with` block ends it at once."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._pool = multiprocessing.get_context("spawn").Pool(1, _prepare)
        self._running: AsyncResult[Refreshed] | None = None
        self._n_seen = 0

    @property
    def is_busy(self) -> bool:
        """Whether a refreshment is under way or has not been taken."""
        return self._running is not None

    def offer(self, session: Session) -> None:
        """Begin with a session, if there is nothing else to do and it has grown enough."""
        if not self.is_busy and len(session.observations) >= max(FEWEST_READINGS, GROWTH * self._n_seen):
            self._begin(session)

    def take(self) -> Refreshed | None:
        """What was found, once; None where it is not ready, or the readings do not support a fit yet."""
        if self._running is None or not self._running.ready():
            return None
        running, self._running = self._running, None
        try:
            return running.get()
        except InvalidInput:
            return None

    def last(self, session: Session) -> Refreshed | None:
        """Posterior and verdict of a session that will not grow any more; waits for them."""
        found = self._wait()
        if len(session.observations) > self._n_seen:
            self._begin(session)
            found = self._wait() or found
        return found

    def _begin(self, session: Session) -> None:
        self._n_seen = len(session.observations)
        self._running = self._pool.apply_async(refreshed, (session, self._seed))

    def _wait(self) -> Refreshed | None:
        if self._running is not None:
            self._running.wait()
        return self.take()

    def __enter__(self) -> Background:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._pool.terminate()
        self._pool.join()


def _prepare() -> None:
    """Of the process: the readings come first, Ctrl-C is for the program that started it."""
    os.nice(NICENESS)
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _label(cause: Mapping[str, str]) -> str:
    return f"{cause['name']}[{cause['place']}]" if cause.get("place") else cause["name"]
