"""Runs a batch: fits every session, coil and hypothesis on a cluster, then samples the probable hypotheses.

A batch that was interrupted, or is repeated with more sessions, does only what is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from estimator.batching.engine import cluster, run_here
from estimator.batching.jobs import PLAIN, Job, stacks
from estimator.batching.result import BatchResult
from estimator.batching.tables import sessions_of
from estimator.batching.work import CALIBRATION_FOLDER, RESULT_FILE, describe, fit, is_enough, sampled
from estimator.devices import device_named, precision_named
from estimator.diagnosis import effort
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.rig_files.read import load_rig
from estimator.store.files import kind_of
from estimator.store.importers.forms.recipe import read_recipe
from estimator.store.made import Made
from estimator.store.staging import only_writer

# A larger stack is slower than two smaller ones, because it no longer fits the processor's cache.
STACK_READINGS, STACK_JOBS = 8000 // (1 + effort.MORE_STARTS), 64
LEADS_ABOVE = 0.05  # probability of a hypothesis above which its posterior is sampled
JOBS, SESSIONS = "jobs", "sessions"
MADE = Made(
    "a batch",
    "",  # nothing replaces one
    (JOBS, "summary.csv", "summary.parquet", "overview.html"),
    lambda folder: kind_of(folder / JOBS) == "a folder",
)


def batch(
    sessions: Sequence[Path | str],
    *,
    out: Path | str,
    rig: Path | str | None = None,
    columns: Path | str | None = None,
    hypotheses: Sequence[str] = (PLAIN,),
    is_each_coil: bool = False,
    has_posterior: bool = True,
    seed: int = 0,
    settings: SamplerSettings | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    device: str = "cpu",
    precision: str = "double",
    as_described: bool = False,
    tell: Callable[[int, int, str], None] | None = None,
) -> BatchResult:
    """Calibrate many sessions.

    Each is fitted under each hypothesis (Levenberg-Marquardt from several starts, Laplace); sessions of the same rig at the same settings
    are fitted together on the batch axis. Then emcee samples the hypotheses with a probability above 5 % among those of their session.

    Args:
        sessions: Folders written by coilcal import, simulate or acquire, or tables of readings, which are imported into `out` first.
            Workers on other computers must see them, and `out`, too.
        out: Folder for the results, with one folder for each job. Jobs that are finished there are skipped.
        rig: Another description of the rig of all sessions, and the rig of tables.
        columns: File that says how columns of tables are read, as coilcal import writes it; readings CSV need none.
        hypotheses: `plain` for the rig as described, or causes that are free in addition, joined by +: `axis_gain+sensor_offset`.
        is_each_coil: Calibrate each coil by itself, from the readings in which it alone carries current.
        has_posterior: Sample the leading hypotheses.
        seed: Seed of starts and sampling.
        settings: When to stop sampling. A posterior that ended before these targets is continued.
        workers, scheduler: Number of processes on this computer, 0 for none but this one; or the address of a Dask scheduler.
        device: Where readings are predicted, such as `cuda`; the workers of a computer share it.
        precision: `double`, or `single` for predictions of readings; last steps of fits and all reports are in double precision.
        as_described: Fit rigs as they are described, without a field of the room and a zero of each sensor where they mention none.
        tell: Called with the number of finished jobs, the number of all jobs, and what was done in words.
    Returns: The results, and the reasons of sessions that failed, which do not stop the others.
    Raises:
        InvalidInput: No session, an output that cannot be written, a scheduler that does not answer.
    """
    if not sessions:
        raise InvalidInput("sessions must be at least one; received none")
    if scheduler is None:  # workers of a cluster may have what this computer has not
        device_named(device)
    precision_named(precision)
    MADE.check_open(Path(out))
    folder = Path(out).absolute() / JOBS
    described_rig = load_rig(rig) if rig else None
    recipe = None if columns is None else read_recipe(Path(columns))
    hypotheses, chosen = tuple(dict.fromkeys(hypotheses)), settings or SamplerSettings()
    paths = list(dict.fromkeys(str(Path(path).absolute()) for path in sessions))
    with (
        only_writer(out),
        nullcontext() if workers == 0 else cluster(workers, scheduler) as connected,
    ):
        folder.mkdir(exist_ok=True)
        make = run_here if connected is None else connected.run
        run = _Run(folder, make, tell or (lambda done, total, words: None))
        paths, run.failed = sessions_of(paths, folder.parent / SESSIONS, described_rig, recipe, seed)
        described = run.describe(
            paths, (described_rig, hypotheses, is_each_coil, seed, chosen, (device, precision), as_described)
        )
        described.sort(
            key=lambda job: (paths.index(job.session), job.coil or "", hypotheses.index(job.hypothesis))
        )
        jobs = run.without_copies(described)
        result = run.fit(jobs)
        if has_posterior:
            run.sample(_leaders(jobs, result), chosen)
    return replace(result, n_new=run.n_new)


class _Run:
    """The stages of a batch, and its progress.

    Attributes:
        failed: Reason for each session or job that failed.
        n_new: Number of fits and posteriors made so far.
    """

    def __init__(
        self, folder: Path, make: Callable[..., None], tell: Callable[[int, int, str], None]
    ) -> None:
        self.failed: dict[str, str] = {}
        self.n_new = 0
        self._folder, self._make, self._tell = folder, make, tell
        self._done = self._total = 0

    def describe(self, paths: Sequence[str], arguments: tuple[Any, ...]) -> list[Job]:
        """The jobs of all sessions, in the order in which they come back."""
        jobs: list[Job] = []

        def receive(path: Any, described: Any) -> None:
            if not isinstance(described, tuple):
                self._fail(path, described)
                return
            jobs.extend(described[0])
            for what, why in described[1].items():
                self._fail(what, why)

        self._make({path: (describe, (path, *arguments)) for path in paths}, receive)
        return jobs

    def without_copies(self, jobs: Sequence[Job]) -> list[Job]:
        """The jobs without those whose readings are stored a second time."""
        first: dict[str, Job] = {}
        for job in jobs:
            original = first.setdefault(job.key, job)
            if original is not job:
                words = (
                    f"{job.session} holds the readings of {original.session}: {job.hypothesis} is fitted once"
                )
                self._tell(0, 0, words)
        return list(first.values())

    def fit(self, jobs: Sequence[Job]) -> BatchResult:
        """Fit the jobs that have no result yet."""
        unfinished = [
            stack
            for stack in stacks(jobs, STACK_READINGS, STACK_JOBS)
            if not all(self._is_fitted(job) for job in stack)
        ]
        waiting = [[job for job in stack if not self._is_fitted(job)] for stack in unfinished]
        self._begin(len(jobs), sum(self._is_fitted(job) for job in jobs))

        def receive(i: Any, failed: Any) -> None:
            reasons = failed if isinstance(failed, dict) else {job.name: failed for job in waiting[i]}
            fitted = [job for job in waiting[i] if self._is_fitted(job)]
            self._add(len(fitted), "fitted")
            for job in waiting[i]:
                if job not in fitted:
                    self._fail(job.name, reasons.get(job.name, "its result is missing"))

        self._make({i: (fit, (stack, str(self._folder))) for i, stack in enumerate(unfinished)}, receive)
        fitted = {job.name: job.session for job in jobs if self._is_fitted(job)}
        return BatchResult(self._folder, tuple(fitted), self.failed, sessions=fitted)

    def sample(self, jobs: Sequence[Job], settings: SamplerSettings) -> None:
        """Sample the jobs whose posterior does not meet the targets yet."""
        unfinished = {
            job.name: job
            for job in jobs
            if not is_enough(self._folder / job.name / CALIBRATION_FOLDER, settings)
        }
        self._begin(len(jobs), len(jobs) - len(unfinished))

        def receive(name: Any, failed: Any) -> None:
            if failed is None:
                self._add(1, f"{name} sampled")
            else:
                self._fail(name, failed)

        self._make(
            {name: (sampled, (job, str(self._folder), settings)) for name, job in unfinished.items()}, receive
        )

    def _is_fitted(self, job: Job) -> bool:
        return (self._folder / job.name / RESULT_FILE).exists()

    def _begin(self, total: int, done: int) -> None:
        """Begin a stage, of which an earlier call may have done a part."""
        self._total, self._done = total, done
        if done:
            self._tell(done, total, "done before")

    def _add(self, number: int, words: str) -> None:
        """Count new fits or posteriors."""
        self._done += number
        self.n_new += number
        self._tell(self._done, self._total, words)

    def _fail(self, what: str, why: object) -> None:
        """Note the failure of a session or job; the others go on."""
        self.failed[what] = str(why)
        self._tell(self._done, self._total, f"{what} failed: {why}")


def _leaders(jobs: Sequence[Job], result: BatchResult) -> list[Job]:
    """The jobs whose hypothesis is probable among those of their session."""
    log_evidence = {
        name: record["log_evidence"] for name, record in zip(result.names, result.records(), strict=True)
    }
    leaders = []
    for job in jobs:
        if job.name not in log_evidence:
            continue
        rivals = np.array(
            [log_evidence[o.name] for o in jobs if o.subject == job.subject and o.name in log_evidence]
        )
        weight = np.exp(log_evidence[job.name] - rivals.max())
        if weight / np.exp(rivals - rivals.max()).sum() > LEADS_ABOVE:
            leaders.append(job)
    return leaders
