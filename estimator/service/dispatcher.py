"""Starts jobs on workers, ends those that were cancelled or took too long, and records what became of them.

The state of a job's work is its folder, so nothing is lost with this process: the next one queues again what ran.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from distributed import Future

from estimator.batching.engine import Cluster, cluster, outcome
from estimator.errors import CoilcalError, CorruptStore
from estimator.json_files import read_json
from estimator.service.job_queue import FAILED, RUNNING, JobQueue
from estimator.service.schema import Job
from estimator.service.settings import Settings
from estimator.service.storage import shortage
from estimator.service.work import JOB, RESULT, STOP, run_job
from estimator.store.files import sync, write_text

LOOK_EVERY_S = 0.5
FULL_EVERY_S = 5.0  # between two looks while the disk is full
GRACE_S = 1.0  # in which a cancelled job may notice it; most look five times a second
END_S = 10.0  # for cancelled jobs when the service ends
log = logging.getLogger("coilcal.service")


@dataclass
class _Running:
    future: Future[Any]
    begin_s: float


class Dispatcher:
    """A thread that keeps the workers busy.

    Args:
        queue: The jobs.
        settings: Number of workers and the time that a job may take.
        folder: Where jobs have their folders, each under its id.
        session_path: Folder of a session, by its id.
        rig_text: Text of a rig, by its id.
        registry_path: Folder of the registry of a rig, by its name.
    """

    def __init__(
        self,
        queue: JobQueue,
        settings: Settings,
        folder: Path,
        session_path: Callable[[str], Path],
        rig_text: Callable[[str], str],
        registry_path: Callable[[str], Path],
    ) -> None:
        self._queue, self._settings, self._folder = queue, settings, folder
        self._session_path, self._rig_text, self._registry_path = session_path, rig_text, registry_path
        self._running: dict[str, _Running] = {}
        self._unbegun: set[str] = set()  # taken from the queue, but without a folder
        self._ending: list[threading.Thread] = []
        self._wake, self._stopping = threading.Event(), threading.Event()
        self._ready = threading.Event()
        self.fault: str | None = None
        self._thread = threading.Thread(target=self._run, name="coilcal dispatcher", daemon=True)

    def start(self) -> None:
        """Take back what an earlier process left, and begin."""
        self._queue.take_back()
        self._thread.start()

    def stop(self) -> None:
        """End the workers; their jobs go on when the service starts again."""
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout=60)

    def wake(self) -> None:
        """There is something new in the queue, or to cancel."""
        self._wake.set()

    @property
    def is_ready(self) -> bool:
        """Whether jobs can run."""
        return self._ready.is_set() and self._thread.is_alive()

    def folder(self, job_id: str) -> Path:
        """Folder of a job."""
        return self._folder / job_id

    def _run(self) -> None:
        scheduler = self._settings.scheduler or None
        workers = None if scheduler else self._settings.n_workers
        try:
            with cluster(workers, scheduler) as workers_of_jobs:
                self._ready.set()
                while not self._stopping.is_set():
                    self._wake.wait(self._looked(workers_of_jobs))
                    self._wake.clear()
                for thread in self._ending:
                    thread.join(END_S)
        except Exception as error:
            self.fault = str(error) if isinstance(error, CoilcalError) else type(error).__name__
            log.exception("jobs can no longer run")
        finally:
            self._ready.clear()

    def _looked(self, workers: Cluster) -> float:
        """Look, and say when to look again: a disk that is full for a while ends no job and holds none up for ever."""
        try:
            self._look(workers)
        except Exception as error:
            if (problem := shortage(error)) is None:
                raise
            log.error("jobs wait", extra={"fault": str(problem)})
            return FULL_EVERY_S
        return LOOK_EVERY_S

    def _look(self, workers: Cluster) -> None:
        """Record what has ended, end what must not go on, start what may. A look that fails may be made again."""
        for job_id in list(self._unbegun):
            self._queue.give_back(job_id)
            self._unbegun.discard(job_id)
        states = self._queue.states(list(self._running))
        for job_id, running in list(self._running.items()):
            ending = outcome(running.future)
            most_s = 3600.0 * self._settings.most_job_hours
            if states.get(job_id) != RUNNING:
                self._end(workers, job_id, running)
            elif ending is not None:
                self._record(job_id, ending)
            elif time.monotonic() - running.begin_s > most_s:
                fault = f"job must end within {self._settings.most_job_hours:g} h; it took longer"
                self._queue.end(job_id, {"state": FAILED, "fault": fault})
                self._end(workers, job_id, running)
            else:
                continue
            del self._running[job_id]
        self._ending = [thread for thread in self._ending if thread.is_alive()]  # these have a worker still
        n_free = self._settings.n_workers - len(self._running) - len(self._ending)
        while n_free > 0 and (job := self._queue.next()) is not None:
            self._begin(workers, job)
            n_free -= 1

    def _begin(self, workers: Cluster, job: Job) -> None:
        folder = self.folder(job.id)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # Written at each start: its paths are others after a backup was restored into another folder.
            write_text(folder / JOB, json.dumps(self._assignment(job), indent=2) + "\n")
            sync(folder)
        except (CoilcalError, OSError) as error:
            if shortage(error) is not None:
                self._unbegun.add(job.id)
                raise
            self._queue.end(job.id, {"state": FAILED, "fault": f"job must have a folder; it cannot: {error}"})
            return
        call = run_job, (str(folder.absolute()), str(self._session_path(job.session_id).absolute()))
        self._running[job.id] = _Running(workers.start(call, self._wake.set), time.monotonic())
        log.info("job begins", extra={"job": job.id, "start": job.starts})

    def _assignment(self, job: Job) -> dict[str, Any]:
        """Content of `job.json`, which the worker reads."""
        options = dict(job.options)
        sessions = options.pop("session_ids", [job.session_id])
        registry = options.pop("registry", None)  # name of a rig
        return {
            "id": job.id,
            "kind": job.kind,
            "options": options,
            "rig": None if job.rig_id is None else self._rig_text(job.rig_id),
            "sessions": [str(self._session_path(session_id).absolute()) for session_id in sessions],
            "has_alerts": bool(self._settings.alert_command),
            "registry": None if registry is None else str(self._registry_path(registry).absolute()),
        }

    def _end(self, workers: Cluster, job_id: str, running: _Running) -> None:
        """End the work of a job while others go on: it ends itself where it looks at the file soon enough; else its worker is replaced."""
        (self.folder(job_id) / STOP).touch()

        def end() -> None:
            end_s = time.monotonic() + GRACE_S
            while outcome(running.future) is None and time.monotonic() < end_s:
                time.sleep(0.05)
            if outcome(running.future) is None:
                workers.stop(running.future)  # takes seconds: a worker is replaced
            self._wake.set()

        thread = threading.Thread(target=end, name=f"end of job {job_id}", daemon=True)
        self._ending.append(thread)
        thread.start()

    def _record(self, job_id: str, ending: str) -> None:
        if ending == "lost":
            self._queue.give_back(job_id)
            return
        file = self.folder(job_id) / RESULT
        try:
            result = read_json(file, fault=CorruptStore)
        except CorruptStore as error:
            # Without a file the work raised something that it does not explain.
            words = str(error).replace(str(file), RESULT) if file.exists() else f"it ended with {ending}"
            log.error("job failed", extra={"job": job_id, "fault": words})
            result = {"state": FAILED, "fault": f"job must end with a result; {words}"}
        self._queue.end(job_id, result)
        log.info("job ended", extra={"job": job_id, "state": result["state"]})
