"""Jobs of each kind are asked for: what each takes, and its place in the queue."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends
from pydantic import BaseModel, Field
from starlette.responses import Response

from estimator.inference.ensemble import SamplerSettings
from estimator.rig_files.read import rig_from_text
from estimator.service.answers import shown_as
from estimator.service.ownership import check_registry
from estimator.service.requests import ID, ChangeOf, Key, Seed, router_of
from estimator.service.routes.jobs import JobInfo, Kind
from estimator.service.routes.rigs import rig_row_of
from estimator.service.routes.sessions import closed_row_of
from estimator.store.session import load_session

router = router_of("/v1/jobs", "jobs")
MOST_SESSIONS = 200  # of a batch

SessionId = Annotated[str, Field(pattern=ID, description="A closed session.")]
RigId = Annotated[
    str | None,
    Field(pattern=ID, description="Another description of the session's rig; its own where left out."),
]
AsDescribed = Annotated[
    bool,
    Field(
        description="Leave out a field of the room and a zero of each sensor that the rig does not mention."
    ),
]
Word = Annotated[str, Field(min_length=1, max_length=200)]


class Sampling(BaseModel, extra="forbid"):
    """When to stop sampling; as `SamplerSettings`."""

    n_walkers: Annotated[int, Field(ge=0, le=2000)] = 0
    target_ess: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] = SamplerSettings.target_ess
    largest_rhat: Annotated[float, Field(gt=1, le=10, allow_inf_nan=False)] = SamplerSettings.largest_rhat
    max_steps: Annotated[int, Field(ge=1, le=1_000_000)] = SamplerSettings.max_steps
    check_every: Annotated[int, Field(ge=1, le=10_000)] = SamplerSettings.check_every


class NewJob(BaseModel, extra="forbid"):
    """What every job has."""

    rig_id: RigId = None


class NewFit(NewJob):
    """A job with one session."""

    session_id: SessionId
    seed: Seed = 0


class NewCalibration(NewFit):
    """A calibration to make."""

    settings: Sampling = Sampling()
    has_integer_counts: Annotated[bool, Field(description="Treat free loop counts as whole numbers.")] = True
    as_described: AsDescribed = False


class NewDiagnosis(NewFit):
    """A diagnosis to make."""

    has_posterior: Annotated[bool, Field(description="Sample the posterior of the extended rig.")] = False
    has_corrections: Annotated[
        bool, Field(description="Correct predictions by what is left without a name.")
    ] = True
    minutes: Annotated[
        float | None, Field(gt=0, le=1e5, allow_inf_nan=False, description="Time for the search.")
    ] = None
    most_causes: Annotated[int | None, Field(ge=0, le=50)] = None
    most_readings: Annotated[int | None, Field(ge=20, le=100_000)] = None


class NewRecalibration(NewFit):
    """A session to judge against the current version of its rig's registry."""

    settings: Sampling = Sampling()


class NewDesign(NewJob):
    """Readings to propose after a session, with one of three aims."""

    session_id: SessionId
    split: Annotated[list[Word], Field(max_length=20, description="Causes to be told apart.")] = []
    shrink: Annotated[Word | None, Field(description="Parameter whose interval is to shrink.")] = None
    correction: Annotated[Word | None, Field(description="Correction to be determined by a map.")] = None
    degree: Annotated[int, Field(ge=1, le=5, description="Highest degree of the correction's terms.")] = 3
    n_readings: Annotated[int, Field(ge=1, le=500)] = 20


class NewBatch(NewJob):
    """Sessions to fit under several hypotheses."""

    session_ids: Annotated[
        list[Annotated[str, Field(pattern=ID)]],
        Field(min_length=1, max_length=MOST_SESSIONS, description="Closed sessions."),
    ]
    seed: Seed = 0
    hypotheses: Annotated[
        list[Word],
        Field(
            min_length=1,
            max_length=50,
            description="`plain` for the rig as described, or causes that are free in addition, joined by +.",
        ),
    ] = ["plain"]
    is_each_coil: Annotated[bool, Field(description="Calibrate each coil by itself.")] = False
    has_posterior: Annotated[bool, Field(description="Sample the probable hypotheses.")] = True
    as_described: AsDescribed = False
    settings: Sampling = Sampling()


KNOWN: dict[int | str, dict[str, Any]] = {200: {"model": JobInfo, "description": "The key was used before."}}


class Submission:
    """What a request for a job comes with besides its body: who asks, and the key that makes a repeated request the same job.

    Args:
        change: The call.
        response: Its answer.
        key: Given by the client.
    """

    def __init__(self, change: ChangeOf, response: Response, key: Key = None) -> None:
        self._change, self._response, self._key = change, response, key
        self.core, self.caller = change.core, change.caller

    def queue(self, kind: Kind, session_ids: list[str], body: NewJob, **more: Any) -> JobInfo:
        """Queue a job on closed sessions; one with the same key that is there already is given back.

        Args:
            kind: What it does.
            session_ids: With which sessions.
            body: All that was asked for. What is neither a session nor the rig is an option of the job.
            more: Options beside.
        """
        core, rig_id = self.core, body.rig_id
        sessions = [closed_row_of(core, session_id) for session_id in session_ids]
        if rig_id is not None:
            rig = rig_from_text(rig_row_of(core, rig_id).text, "rig")
            for session in sessions:
                load_session(core.sessions.path(session.id)).check_rig(rig)
        asked = {
            "kind": kind,
            "user": self.caller.user,
            "session_id": session_ids[0],
            "rig_id": rig_id,
            "options": {**more, **body.model_dump(exclude={"session_id", "rig_id"})},
            "idempotency_key": self._key,
        }
        with core.database.writing() as db:
            job, is_new = core.queue.add(db, asked)
            if is_new:
                self._change.note(db, f"job.{kind}", job.id)
            else:
                self._response.status_code = 200
        core.jobs.wake()
        return shown_as(JobInfo, job)


Submitted = Annotated[Submission, Depends()]


@router.post("/calibrate", status_code=201, responses=KNOWN)
def calibrate(submission: Submitted, body: NewCalibration) -> JobInfo:
    """Queue a calibration: point estimate, posterior, model."""
    return submission.queue("calibrate", [body.session_id], body)


@router.post("/diagnose", status_code=201, responses=KNOWN)
def diagnose(submission: Submitted, body: NewDiagnosis) -> JobInfo:
    """Queue a diagnosis: what the simulation gets wrong, named, and the rig extended by it."""
    return submission.queue("diagnose", [body.session_id], body)


@router.post("/recalibrate", status_code=201, responses=KNOWN)
def recalibrate(submission: Submitted, body: NewRecalibration) -> JobInfo:
    """Queue the judgement of a session in the registry of a rig of one's own: does the current version hold, and what replaces it."""
    session = closed_row_of(submission.core, body.session_id)
    version = rig_row_of(submission.core, body.rig_id or session.rig_id)
    check_registry(submission.core, submission.caller, version.name)
    return submission.queue("recalibrate", [body.session_id], body, registry=version.name)


@router.post("/batch", status_code=201, responses=KNOWN)
def batch(submission: Submitted, body: NewBatch) -> JobInfo:
    """Queue the calibration of many sessions, with the probabilities of the hypotheses."""
    return submission.queue("batch", body.session_ids, body)


@router.post("/design", status_code=201, responses=KNOWN)
def design(submission: Submitted, body: NewDesign) -> JobInfo:
    """Queue a proposal of the next readings: to tell causes apart, to shrink an interval, or to map a correction."""
    return submission.queue("design", [body.session_id], body)
