"""The jobs of a batch: one fit for each session, coil and hypothesis, identified by everything that decides its result."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from estimator.batching.stacked import settings_hash
from estimator.calibration.calibrate import versions
from estimator.effects import effect_of
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.everywhere import with_everywhere
from estimator.errors import CoilcalError, InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.model.hide import cause_of
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session, load_session

PLAIN = "plain"


@dataclass(frozen=True)
class Job:
    """One fit of a batch.

    Attributes:
        session: Path of the session.
        rig: Another description of its rig; None for its own.
        coil: The coil to calibrate, from readings in which it alone carries current; None for the whole rig.
        hypothesis: `plain`, or free causes joined by +.
        seed: Seed of starts and sampling.
        device, precision: Where and how precisely readings are predicted.
        session_hash: Hash of the readings, wherever they are stored.
        key: Hash of what decides the result: session, rig, hypothesis, seed, versions and the settings that decide a chain.
        settings: Hash of rig and settings; jobs that share it can be stacked.
        n_readings: Number of fitted readings.
        as_described: Whether the rig is fitted without what no laboratory is without and it does not mention.
    """

    session: str
    rig: Rig | None
    coil: str | None
    hypothesis: str
    seed: int
    device: str = "cpu"
    precision: str = "double"
    session_hash: str = ""
    key: str = ""
    settings: str = ""
    n_readings: int = 0
    as_described: bool = False

    @property
    def name(self) -> str:
        """Name of the result folder: readable, and different for every different result."""
        words = [Path(self.session).stem, *([self.coil] if self.coil else []), self.hypothesis, self.key[:10]]
        return "-".join(re.sub(r"[^\w.+]+", "_", word).strip("_") for word in words)

    @property
    def subject(self) -> tuple[str, str | None]:
        """Session and coil, for which hypotheses compete."""
        return self.session_hash, self.coil


def jobs_of(
    path: str,
    rig: Rig | None,
    hypotheses: Sequence[str],
    is_each_coil: bool,
    seed: int,
    settings: SamplerSettings | None = None,
    place: tuple[str, str] = ("cpu", "double"),
    as_described: bool = False,
) -> tuple[list[Job], dict[str, str]]:
    """The jobs of one session, and the reasons against others: no reading for a coil, or no such hypothesis in its rig.

    Raises:
        CoilcalError: The session cannot be read, or is of another rig.
    """
    session = load_session(path)
    if rig is not None:
        session.check_rig(rig)
    coils: list[str | None] = [coil.name for coil in session.rig.coils] if is_each_coil else [None]
    jobs, refused = [], {}
    for coil in coils:
        for hypothesis in hypotheses:
            job = Job(path, rig, coil, hypothesis, seed, *place, session.hash, as_described=as_described)
            try:
                jobs.append(_keyed(job, session, settings or SamplerSettings()))
            except CoilcalError as error:
                refused[", ".join((path, *([coil] if coil else []), hypothesis))] = str(error)
    return jobs, refused


def readings_and_rig(job: Job, session: Session) -> tuple[Session, Rig]:
    """The readings of a job, and the rig with the causes of its hypothesis free.

    Raises:
        InvalidInput: The coil never carries current alone, or the hypothesis does not exist in this rig, or is in every hypothesis.
    """
    rig = job.rig or session.rig
    if job.coil is not None:
        session, rig = _one_coil(session, rig, job.coil)
    in_all = () if job.as_described else with_everywhere(rig, session.observations.calibration).added
    for cause_text in () if job.hypothesis == PLAIN else job.hypothesis.split("+"):
        rig = _with_cause(rig, session.observations, cause_text, in_all)
    return session, rig


def rig_to_fit(job: Job, rig: Rig, observations: Observations) -> Rig:
    """The rig of a job with what no laboratory is without, as `calibrate` adds it, unless it is fitted as described.

    Args:
        job: The job.
        rig: Its rig with the causes of its hypothesis.
        observations: The readings of the fit.
    """
    return rig if job.as_described else with_everywhere(rig, observations).rig


def stacks(jobs: Sequence[Job], most_readings: int, most_jobs: int) -> Iterator[list[Job]]:
    """Jobs to fit together: those of the same rig at the same settings, finished or not."""
    by_settings: dict[str, list[Job]] = {}
    for job in sorted(jobs, key=lambda job: job.key):
        by_settings.setdefault(job.settings, []).append(job)
    for alike in by_settings.values():
        width = max(1, min(most_jobs, most_readings // max(alike[0].n_readings, 1)))
        for first in range(0, len(alike), width):
            yield alike[first : first + width]


def _keyed(job: Job, session: Session, settings: SamplerSettings) -> Job:
    """The job with its key and settings hash."""
    job_session, rig = readings_and_rig(job, session)
    observations = job_session.observations.calibration
    rig = rig_to_fit(job, rig, observations)
    chain = [settings.n_walkers, settings.check_every]  # its targets do not decide its steps
    decisive = [job.session_hash, rig.hash, job.coil, job.hypothesis, job.seed, versions(), chain]
    if (job.device, job.precision) != ("cpu", "double"):
        decisive += [job.device, job.precision]
    return replace(
        job,
        key=hashlib.sha256(json.dumps(decisive).encode()).hexdigest(),
        settings=settings_hash(rig, observations),
        n_readings=len(observations),
    )


def _with_cause(rig: Rig, observations: Observations, text: str, in_all: Sequence[Cause]) -> Rig:
    cause = cause_of(text, rig)
    if cause in in_all:
        raise InvalidInput(f"hypothesis {text!r} is a part of all, unless rigs are fitted as described")
    if cause in rig.acting:
        raise InvalidInput(f"hypothesis {text!r} must not be in the rig already")
    shapes = effect_of(cause.name).starts(Circumstances(rig, observations), cause.place)[0]
    return with_effect(rig, cause, observations, shapes)


def _one_coil(session: Session, rig: Rig, name: str) -> tuple[Session, Rig]:
    """Readings without current in other coils, and the rig with the parameters of other coils fixed (paper, eq 17)."""
    names = [coil.name for coil in rig.coils]
    column = names.index(name)
    other_currents_A = session.observations.current_A.clone()
    other_currents_A[:, column] = 0.0
    is_alone = (other_currents_A == 0.0).all(1)
    if not bool((session.observations.current_A[is_alone, column] != 0.0).any()):
        raise InvalidInput(f"{name} must carry current alone in some reading; it never does")
    fixed = [p.name for p in rig.free if p.name.partition(".")[0] in set(names) - {name}]
    observations = session.observations.rows(is_alone)
    one_coil = Session(rig, observations, session.source, session.created, session.truth)
    return one_coil, rig.with_fixed(fixed)
