"""The slow half of a live calibration: posterior and diagnosis of the readings so far, in a background process."""

from __future__ import annotations

import os
import pickle
import signal
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection

import torch

from drivers.children import SPAWN, start_without_main
from estimator.calibration.calibrate import calibrate
from estimator.diagnosis.diagnose import diagnose
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.store.session import Session

QUICK = SamplerSettings(target_ess=400.0, largest_rhat=1.05, max_steps=3000)
FEWEST_READINGS = 15
GROWTH = 1.25  # factor by which a session grows between two refreshments
NICENESS = 10


@dataclass(frozen=True)
class Refreshed:
    """Posterior and verdict of the first readings of a session.

    Attributes:
        n_readings: Number of these readings, validation included.
        best: Values at the maximum of the posterior.
        ci90: 90 % credible interval of each free parameter, from posterior draws.
        verdict: Verdict of the diagnosis.
        causes: Named causes, each with those that it cannot be told from, and how many readings were recorded wrongly.
        took_s: Duration of the work.
        places: Sensors, coils and movers that the named causes belong to.
    """

    n_readings: int
    best: Mapping[str, float]
    ci90: Mapping[str, tuple[float, float]]
    verdict: str
    causes: tuple[str, ...]
    took_s: float
    places: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The verdict as an operator reads it."""
        causes = f": {', '.join(self.causes)}" if self.causes else ""
        return f"{self.verdict.replace('_', ' ')}{causes} (after {self.n_readings} readings)"


def refreshed(session: Session, seed: int) -> Refreshed:
    """Posterior and verdict of a session.

    Raises:
        InvalidInput: The readings cannot support a fit yet.
    """
    begin_s = time.monotonic()
    calibration = calibrate(session, settings=QUICK, seed=seed)
    parameters = calibration.summary()["parameters"]
    diagnosis = diagnose(session, seed=seed)
    causes = diagnosis.sized_causes
    named = [" or ".join([sized.cause.label, *(name for name, _ in sized.others)]) for sized in causes]
    n_wrong = sum(len(flag.readings) for flag in diagnosis.findings.flags)
    named += [f"{n_wrong} readings recorded wrongly"] if n_wrong else []
    return Refreshed(
        len(session.observations),
        dict(calibration.best),
        {name: (numbers["ci90"][0], numbers["ci90"][1]) for name, numbers in parameters.items()},
        str(diagnosis.verdict),
        tuple(named),
        time.monotonic() - begin_s,
        tuple(sized.cause.place for sized in causes),
    )


class Background:
    """Refreshes sessions one after another in a process of its own; leaving the `with` block ends the process at once.

    Attributes:
        trouble: Why the last refreshment failed although there were enough readings, in a sentence; None if it did not fail.
    """

    def __init__(self, seed: int) -> None:
        self.trouble: str | None = None
        self._seed = seed
        self._is_busy = False
        self._n_seen = 0
        self._sending: threading.Thread | None = None
        self._start()

    @property
    def is_busy(self) -> bool:
        """Whether a refreshment is under way, or done and not taken yet."""
        return self._is_busy

    def wants(self, n_readings: int) -> bool:
        """Whether the process is free and a session of this size has grown enough."""
        return not self._is_busy and n_readings >= max(FEWEST_READINGS, GROWTH * self._n_seen)

    def offer(self, session: Session) -> None:
        """Refresh a session if it is wanted."""
        if self.wants(len(session.observations)):
            self.begin(session)

    def take(self) -> Refreshed | None:
        """Take the result, once; None if it is not ready, the readings do not support a fit yet, or there was trouble."""
        return self._answer() if self._is_busy and self._pipe.poll() else None

    def last(self, session: Session) -> Refreshed | None:
        """Wait for posterior and verdict of a session that has stopped growing."""
        result = self._wait()
        if len(session.observations) > self._n_seen or self.trouble is not None:
            self.begin(session)
            result = self._wait() or result
        return result

    def _start(self) -> None:
        self._pipe, child_end = SPAWN.Pipe()
        self._process = SPAWN.Process(target=_serve, args=(child_end, self._seed), daemon=True)
        start_without_main(self._process)
        child_end.close()  # so that the pipe ends with the process

    def begin(self, session: Session) -> None:
        """Refresh a session, whether or not it has grown; only while the process is free."""
        self._n_seen, self._is_busy = len(session.observations), True
        if not self._process.is_alive():
            self._end()
            self._start()
        # As bytes: tensors that a pipe sends are files in shared memory, which stay open here where the process ends before it reads.
        # By a thread: bytes wait until the process has started, which takes seconds.
        self._sending = threading.Thread(target=_send, args=(self._pipe, pickle.dumps(session)), daemon=True)
        self._sending.start()

    def _answer(self) -> Refreshed | None:
        self._is_busy = False
        try:
            answer: Refreshed | str | None = self._pipe.recv()
        except (EOFError, OSError):
            self._process.join()
            answer = f"the process ended with exit status {self._process.exitcode}"
        if isinstance(answer, str):
            self.trouble = f"posterior and diagnosis after {self._n_seen} readings failed: {answer}"
            return None
        self.trouble = None
        return answer

    def _wait(self) -> Refreshed | None:
        if not self._is_busy:
            return None
        self._pipe.poll(None)
        return self._answer()

    def _end(self) -> None:
        self._process.kill()
        self._process.join()
        if self._sending is not None:
            self._sending.join()  # its pipe has broken
        self._pipe.close()

    def __enter__(self) -> Background:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()


def _send(pipe: Connection, content: bytes) -> None:
    with suppress(OSError):  # the process ended; `_answer` reports it
        pipe.send_bytes(content)


def _serve(pipe: Connection, seed: int) -> None:
    """Body of the process: runs at low priority, and leaves Ctrl-C to the program that started it, with which it ends."""
    os.nice(NICENESS)
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            session: Session = pickle.loads(pipe.recv_bytes())
        except (EOFError, OSError):
            return
        answer: Refreshed | str | None
        try:
            answer = refreshed(session, seed)
        except InvalidInput:  # the readings do not support a fit yet
            answer = None
        except Exception as error:  # must not stop the running estimate
            answer = f"{type(error).__name__}: {error}"
        pipe.send(answer)
