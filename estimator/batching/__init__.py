"""Many sessions at once: every session, coil and hypothesis fitted on a cluster, the leading hypotheses sampled.

A batch that was cut off, or is asked again with more sessions, does only what is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from estimator.batching.engine import cluster
from estimator.batching.jobs import PLAIN, Job, stacks
from estimator.batching.result import BatchResult
from estimator.batching.work import (
    CALIBRATION_FOLDER,
    MORE_STARTS,
    RESULT_FILE,
    describe,
    fit,
    is_enough,
    sampled,
)
from estimator.errors import InvalidInput, reason
from estimator.inference.ensemble import SamplerSettings
from estimator.rig_files.read import load_rig

__all__ = ["BatchResult", "batch"]

STACK_READINGS, STACK_JOBS = (
    8000 // (1 + MORE_STARTS),
    64,
)  # beyond that a stack is slower than two, for it leaves the processor's cache
LEADS_ABOVE = 0.05  # probability of a hypothesis whose posterior is sampled
JOBS = "jobs"


def batch(
    sessions: Sequence[Path | str],
    *,
    out: Path | str,
    rig: Path | str | None = None,
    hypotheses: Sequence[str] = (PLAIN,),
    is_each_coil: bool = False,
    has_posterior: bool = True,
    seed: int = 0,
    settings: SamplerSettings | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    tell: Callable[[int, int, str], None] | None = None,
) -> BatchResult:
    """Calibrate many sessions.

    Each is fitted under each hypothesis (Levenberg-Marquardt from several starts, Laplace); sessions of the same rig at the same settings
    are fitted together on the batch axis. Then emcee samples the hypotheses with a probability above 5 % among those of their session.

    Args:
        sessions: Folders that coilcal import, simulate or acquire wrote. On a cluster of several computers, and `out`, seen by all of them.
        out: Folder for the results, one folder for each job. Jobs that are finished there are skipped.
        rig: Another description of the rig of all sessions.
        hypotheses: `plain` for the rig as it is described, or causes that are free in addition, joined by +: `axis_gain+sensor_offset`.
        is_each_coil: Calibrate each coil by itself, from the readings in which it alone carries current.
        has_posterior: Sample the leading hypotheses.
        seed: Of starts and sampling.
        settings: When to stop sampling. A posterior that ended before what is asked for now goes on.
        workers, scheduler: Number of processes on this computer, or the address of a Dask scheduler.
        tell: Told how many of how many jobs are done, and in words what was.
    Returns: The results, also of sessions that failed: these do not stop the others.
    Raises:
        InvalidInput: No session, an output that cannot be written, a scheduler that does not answer.
    """
    if not sessions:
        raise InvalidInput("sessions must be at least one; received none")
    folder = Path(out).absolute() / JOBS
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InvalidInput(
            f"output must be a folder that can be written; {out} is not: {reason(error)}"
        ) from error
    rig_text = load_rig(rig).text if rig else ""
    hypotheses, chosen = tuple(dict.fromkeys(hypotheses)), settings or SamplerSettings()
    run = _Run(folder, tell or (lambda done, total, words: None), {})
    with cluster(workers, scheduler) as where:
        paths = list(dict.fromkeys(str(Path(path).absolute()) for path in sessions))
        described: list[Job] = []

        def describes(path: Any, found: Any) -> None:
            if not isinstance(found, tuple):
                run.fail(path, found)
                return
            described.extend(found[0])
            for what, why in found[1].items():
                run.fail(what, why)

        arguments = (rig_text, hypotheses, is_each_coil, seed, chosen)
        where.run({path: (describe, (path, *arguments)) for path in paths}, describes)
        described.sort(
            key=lambda job: (paths.index(job.session), job.coil or "", hypotheses.index(job.hypothesis))
        )
        jobs = run.without_copies(described)

        open_stacks = [
            stack
            for stack in stacks(jobs, STACK_READINGS, STACK_JOBS)
            if not all(run.is_fitted(job) for job in stack)
        ]
        run.begin(len(jobs), sum(run.is_fitted(job) for job in jobs))
        where.run(
            {i: (fit, (stack, str(folder))) for i, stack in enumerate(open_stacks)}, run.fitted(open_stacks)
        )
        fitted = {job.name: job.session for job in jobs if run.is_fitted(job)}
        result = BatchResult(folder, tuple(fitted), run.failed, sessions=fitted)
        if has_posterior:
            leaders = _leaders(jobs, result)
            waiting = {job.name: job for job in leaders if not run.is_sampled(job, chosen)}
            run.begin(len(leaders), len(leaders) - len(waiting))
            where.run(
                {name: (sampled, (job, str(folder), chosen)) for name, job in waiting.items()}, run.sampled
            )
    return replace(result, n_new=run.n_new)


class _Run:
    """How far a batch is."""

    def __init__(self, folder: Path, tell: Callable[[int, int, str], None], failed: dict[str, str]) -> None:
        self.folder, self.tell, self.failed = folder, tell, failed
        self.done = self.total = self.n_new = 0

    def begin(self, total: int, done: int) -> None:
        """A new stage, of which some may have been done before."""
        self.total, self.done = total, done
        if done:
            self.tell(done, total, "done before")

    def is_fitted(self, job: Job) -> bool:
        return (self.folder / job.name / RESULT_FILE).exists()

    def is_sampled(self, job: Job, settings: SamplerSettings) -> bool:
        return is_enough(self.folder / job.name / CALIBRATION_FOLDER, settings)

    def without_copies(self, jobs: Sequence[Job]) -> list[Job]:
        """Each fit once, also where the same readings lie in two places."""
        first: dict[str, Job] = {}
        for job in jobs:
            own = first.setdefault(job.key, job)
            if own is not job:
                self.tell(
                    0,
                    0,
                    f"{job.session} holds the readings of {own.session}: {job.hypothesis} is fitted once",
                )
        return list(first.values())

    def fail(self, what: str, why: object) -> None:
        """A failure of a session or job; the others go on."""
        self.failed[what] = str(why)
        self.tell(self.done, self.total, f"{what} failed: {why}")

    def gained(self, number: int, words: str) -> None:
        """Fits or posteriors that are there now."""
        self.done += number
        self.n_new += number
        self.tell(self.done, self.total, words)

    def fitted(self, open_stacks: list[list[Job]]) -> Callable[[Any, Any], None]:
        """What to do when a stack comes back, of which some may have been there before."""
        waiting = [[job for job in stack if not self.is_fitted(job)] for stack in open_stacks]

        def came(i: Any, failed: Any) -> None:
            broken = failed if isinstance(failed, dict) else {job.name: failed for job in waiting[i]}
            made = [job for job in waiting[i] if self.is_fitted(job)]
            self.gained(len(made), "fitted")
            for job in waiting[i]:
                if job not in made:
                    self.fail(job.name, broken.get(job.name, "its result is missing"))

        return came

    def sampled(self, name: Any, failed: Any) -> None:
        """What to do when a posterior comes back."""
        if failed is None:
            self.gained(1, f"{name} sampled")
        else:
            self.fail(name, failed)


def _leaders(jobs: Sequence[Job], result: BatchResult) -> list[Job]:
    """The jobs whose hypothesis is probable among those of its session."""
    evidence = {
        name: record["log_evidence"] for name, record in zip(result.names, result.records(), strict=True)
    }
    found = []
    for job in jobs:
        if job.name not in evidence:
            continue
        rivals = np.array([evidence[o.name] for o in jobs if o.subject == job.subject and o.name in evidence])
        share = np.exp(evidence[job.name] - rivals.max()) / np.exp(rivals - rivals.max()).sum()
        if share > LEADS_ABOVE:
            found.append(job)
    return found
