"""The registry of a rig: which calibration is in use, how it became so over time, and the way back to an earlier one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, Field
from sqlalchemy import select

from estimator.recalibration.history_report import judged, summary_of, versions_in_use
from estimator.recalibration.log import Entry
from estimator.recalibration.recalibrate import roll_back
from estimator.recalibration.registry import Registry, RegistryBusy
from estimator.service.answers import Item, Listing, ListingOf, Page, shown_as
from estimator.service.core import Core
from estimator.service.job_queue import RETRY_AFTER_S
from estimator.service.ownership import OWN_REGISTRY
from estimator.service.problems import Problem
from estimator.service.requests import ChangeOf, CoreOf, Id, router_of
from estimator.service.routes.calibrations import Interval
from estimator.service.routes.rigs import rig_row_of
from estimator.service.schedules import is_judgement_of
from estimator.service.schema import CalibrationRow, Job

router = router_of("/v1/rigs/{rig_id}/registry", "registry")
Row = TypeVar("Row")
MOST_SESSIONS = 500  # ten years of weekly ones
Numbers = Annotated[list[float], Field(min_length=2, max_length=3)]


class RegistryInfo(BaseModel):
    """The registry that all versions of a rig file with one name share; `current` is null before the first calibration."""

    rig_name: str
    current: int | None
    calibration_id: Annotated[str | None, Field(description="Of the current version.")]
    n_versions: int
    n_entries: int


class EntryInfo(BaseModel):
    """A conclusion on a session, or a rollback; as a line of `log.jsonl`."""

    number: int
    conclusion: str
    reason: str
    session_id: str | None
    taken: str
    concluded: str
    version: Annotated[int | None, Field(description="Current from then on.")]
    made: Annotated[int | None, Field(description="Version made from this session.")]
    agrees: bool | None
    causes: list[dict[str, Any]]
    since: str | None
    checks: dict[str, Any]
    estimate: Annotated[dict[str, list[float]], Field(description="Value and standard deviation, in SI.")]


class VersionInfo(BaseModel):
    """A calibration that was in use, with its parameters."""

    version: int
    is_current: bool
    calibration_id: str | None
    session_id: str | None
    conclusion: str
    taken: str
    concluded: str
    parameters: dict[str, Interval]


class NewRollback(BaseModel, extra="forbid"):
    """The version to return to."""

    version: Annotated[int, Field(ge=1, le=10**6)]


def numbered_page(
    listing: Listing, rows: Sequence[tuple[int, Row]], shape: Callable[[tuple[int, Row]], Item]
) -> Page[Item]:
    """A page of numbered rows, the highest number first; the cursor is the last number of the page before."""
    cursor = listing.cursor
    if cursor is not None and not (cursor.isascii() and cursor.isdecimal() and len(cursor) < 10):
        raise Problem(422, "cursor", "must be the `next` of a page", cursor, "query")
    left = [row for row in sorted(rows, key=lambda row: -row[0]) if cursor is None or row[0] < int(cursor)]
    following = str(left[listing.limit - 1][0]) if len(left) > listing.limit else None
    return Page(items=[shape(row) for row in left[: listing.limit]], next=following)


def registry_of(core: Core, rig_id: str) -> tuple[str, Registry]:
    """Name of a rig that must be there, and its registry, which may be empty."""
    name = rig_row_of(core, rig_id).name
    return name, Registry(core.registry_path(name))


@router.get("")
def get_registry(core: CoreOf, rig_id: Id) -> RegistryInfo:
    """The state of a rig's registry."""
    name, registry = registry_of(core, rig_id)
    entries, current = registry.entries(), registry.current
    made = next((entry for entry in entries if entry.made is not None and entry.made == current), None)
    return RegistryInfo(
        rig_name=name,
        current=current,
        calibration_id=None if made is None else _calibration_id(core, name, made),
        n_versions=len(registry.versions),
        n_entries=len(entries),
    )


@router.get("/entries")
def list_entries(rig_id: Id, listing: ListingOf) -> Page[EntryInfo]:
    """Conclusions and rollbacks, newest first."""
    entries = registry_of(listing.core, rig_id)[1].entries()
    return numbered_page(listing, list(enumerate(entries, start=1)), lambda row: _entry_info(*row))


@router.get("/versions")
def list_versions(rig_id: Id, listing: ListingOf) -> Page[VersionInfo]:
    """Versions with their parameters, newest first."""
    name, registry = registry_of(listing.core, rig_id)
    made = [(entry.made, entry) for entry in registry.entries() if entry.made is not None]
    current = registry.current

    def info(row: tuple[int, Entry]) -> VersionInfo:
        version, entry = row
        parameters = registry.calibration(version).summary()["parameters"]
        return VersionInfo(
            version=version,
            is_current=version == current,
            calibration_id=_calibration_id(listing.core, name, entry),
            session_id=_session_id(entry),
            conclusion=entry.conclusion,
            taken=entry.taken,
            concluded=entry.concluded,
            parameters={name: Interval.model_validate(numbers) for name, numbers in parameters.items()},
        )

    return numbered_page(listing, made, info)


@router.post("/roll-back", dependencies=[OWN_REGISTRY])
def roll_back_to(change: ChangeOf, rig_id: Id, body: NewRollback) -> EntryInfo:
    """Make an earlier version of a rig of one's own current again."""
    name, registry = registry_of(change.core, rig_id)
    if not registry.versions:
        raise Problem(409, "registry", "must have a version; it has none", place=f"registry of {name}")
    try:
        with change.core.database.writing() as db:  # a change that cannot be noted is not made
            change.note(db, "registry.roll_back", f"{rig_id} {body.version}")
            db.flush()
            entry = roll_back(registry.folder, body.version)
    except RegistryBusy:
        rule, headers = "must be free; a recalibration is at work on it", {"Retry-After": str(RETRY_AFTER_S)}
        raise Problem(409, "registry", rule, place=name, headers=headers) from None
    return _entry_info(len(registry.entries()), entry)


def _entry_info(number: int, entry: Entry) -> EntryInfo:
    return EntryInfo.model_validate({**asdict(entry), "number": number, "session_id": _session_id(entry)})


def _session_id(entry: Entry) -> str | None:
    return Path(entry.session).stem if entry.session else None


def _calibration_id(core: Core, rig_name: str, entry: Entry) -> str | None:
    """The calibration that the first recalibration of the entry's session for this registry has left."""
    rows = (
        select(CalibrationRow.id)
        .join(Job, Job.id == CalibrationRow.job_id)
        .where(is_judgement_of(rig_name), CalibrationRow.session_id == _session_id(entry))
    )
    with core.database.reading() as db:
        return db.scalars(rows.order_by(Job.number)).first()


class JudgedSession(BaseModel):
    """A session that was judged, and what it says of the parameters by itself."""

    session_id: str
    taken: datetime
    conclusion: str
    cause: Annotated[str, Field(description="Of a drift, in words.")]
    reason: str
    estimate: Annotated[dict[str, Numbers], Field(description="Value and standard deviation, in SI.")]


class PeriodOfUse(BaseModel):
    """A period in which a version was in use, by the time of readings."""

    version: int
    begin: datetime
    end: datetime
    intervals: Annotated[
        dict[str, Numbers], Field(description="Lower end, median and upper end of the 90 % interval, in SI.")
    ]


class RegistryHistory(BaseModel):
    """A registry over time, in order; of many sessions the last ones."""

    rig_name: str
    current: int | None
    units: Annotated[dict[str, str], Field(description="Unit of each parameter in SI.")]
    sessions: list[JudgedSession]
    periods: list[PeriodOfUse]


@router.get("/history")
def get_history(core: CoreOf, rig_id: Id) -> RegistryHistory:
    """Every parameter over time: what each session says of it, and the versions in use."""
    name, registry = registry_of(core, rig_id)
    entries = registry.entries()
    table = registry.history()
    sessions = [(entry, summary_of(entry)) for entry in judged(entries)[-MOST_SESSIONS:]]
    return RegistryHistory(
        rig_name=name,
        current=registry.current,
        units=dict(zip(table.parameter.values.tolist(), table.unit.values.tolist(), strict=True)),
        sessions=[
            JudgedSession(
                session_id=Path(entry.session).stem,
                taken=summary.taken,
                conclusion=summary.conclusion,
                cause=summary.label,
                reason=entry.reason,
                estimate={key: list(numbers) for key, numbers in summary.estimate.items()},
            )
            for entry, summary in sessions
        ],
        periods=[shown_as(PeriodOfUse, period) for period in versions_in_use(registry, entries)],
    )
