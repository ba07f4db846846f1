"""The next stop of an open session, for rigs that other programs drive."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from pydantic import BaseModel, Field

from estimator.planning.goals import reads_file
from estimator.service.next_stops import Question
from estimator.service.problems import Problem
from estimator.service.requests import CoreOf, Id, Seed, router_of, turn
from estimator.service.routes.sessions import open_row_of

router = router_of("/v1/sessions", "sessions")
Goal = Annotated[str, Field(min_length=1, max_length=2000, description="As in `coilcal plan --goal`.")]


class NewQuestion(BaseModel, extra="forbid"):
    """What shall be known, and the stops to choose from."""

    goals: Annotated[list[Goal], Field(min_length=1, max_length=20)]
    places: Annotated[
        str,
        Field(min_length=1, max_length=200_000, description="A plan file with poses and currents, as YAML."),
    ]
    most_stops: Annotated[int, Field(ge=1, le=10_000, description="After which to end in any case.")] = 200
    seed: Seed = 0


class Next(BaseModel):
    """What to measure next, or why the session may end.

    Attributes:
        is_end: The goals are reached, or cannot be reached further; there is no next stop.
        reason: Why this stop, or why the session may end.
        current_A: Of each coil.
        motion: The six numbers of each mover, in SI.
        is_validation: The readings shall be marked so: the fit does not see them.
        widths: Half-width of the 90 % interval of each goal over its target.
        cause: The ordinary cause that may do most unseen, with the size that the readings give it.
        stated: Causes that not even all stops could exclude.
        left: Stops that are expected to be still needed.
    """

    is_end: bool
    reason: str
    current_A: dict[str, float]
    motion: dict[str, list[float]]
    is_validation: bool
    widths: list[float]
    cause: str
    stated: list[str]
    left: int


@router.post("/{session_id}/next", dependencies=[turn("planning")])
def get_next_stop(core: CoreOf, session_id: Id, body: NewQuestion) -> Next:
    """The next stop of an open session, by its readings on disk and goals. The first call prepares candidates for seconds."""
    row = open_row_of(core, session_id)
    for goal in body.goals:
        if reads_file(goal):
            raise Problem(422, "goals", "must state a box or a ball; a service reads no files", goal)
    question = Question(row.id, tuple(body.goals), body.places, body.most_stops, body.seed)
    stop = core.next_stops.answer(question)
    told = asdict(stop.decision)
    return Next(
        is_end=stop.decision.row is None,
        current_A=dict(stop.current_A),
        motion={name: list(columns) for name, columns in stop.motion.items()},
        is_validation=stop.is_validation,
        **{name: told[name] for name in ("reason", "widths", "cause", "stated", "left")},
    )
