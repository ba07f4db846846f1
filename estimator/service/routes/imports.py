"""Sessions that are imported as a whole: a table of readings, or a zipped session."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from fastapi import Depends, Query
from pydantic import BaseModel, Field

from estimator.readings.clock import Clock
from estimator.rig_files.read import rig_from_text
from estimator.service.answers import shown_as
from estimator.service.archives import check_length, unpacked_session
from estimator.service.core import Core
from estimator.service.database import new_id, now
from estimator.service.problems import Problem
from estimator.service.requests import (
    ID,
    Change,
    ChangeOf,
    CoreOf,
    Importing,
    documented_body,
    raw_body,
    router_of,
)
from estimator.service.routes.rigs import rig_row_of
from estimator.service.routes.sessions import CLOSED, SessionInfo
from estimator.service.schema import SessionRow
from estimator.store.files import sync
from estimator.store.importers.forms.preview import Preview, previewed
from estimator.store.importers.forms.recipe import Recipe, named_columns, named_constants
from estimator.store.importers.forms.sources import kind_of
from estimator.store.importers.forms.understand import understood
from estimator.store.session import Session

router = router_of("/v1/sessions", "sessions")
RigId = Annotated[str, Query(pattern=ID, description="Version of the rig on which the readings were taken.")]
Csv = Annotated[bytes, Depends(raw_body("text/csv"))]
Zip = Annotated[bytes, Depends(raw_body("application/zip"))]


class Form(BaseModel):
    """How a table of readings is read; the parameters are those options of `coilcal import`."""

    accept: Annotated[
        bool, Field(description="Accept what was understood of a table that is no readings CSV.")
    ] = False
    column: Annotated[
        list[str], Field(description="Meaning of a column: `HEADER=NAME`.", max_length=200)
    ] = []
    constant: Annotated[
        list[str], Field(description="A column that is missing: `NAME=VALUE`.", max_length=200)
    ] = []
    decimal: Literal["point", "comma"] | None = None
    clock: Clock = Clock.AS_WRITTEN
    skip_bad_lines: bool = False

    def recipe(self) -> Recipe:
        """The recipe that they make.

        Raises:
            InvalidInput: One of them has another form.
        """
        columns, constants = named_columns(self.column), named_constants(self.constant)
        return Recipe(
            columns, constants, decimal=self.decimal, clock=self.clock, skips_bad=self.skip_bad_lines
        )


@router.post("/preview-csv", openapi_extra=documented_body("text/csv", "A table of readings."))
def preview_csv(
    core: CoreOf,
    rig_id: RigId,
    body: Csv,
    turn: Importing,  # noqa: ARG001
    form: Annotated[Form, Query()],
) -> Preview:
    """What would be understood of a table of readings, with its first rows; nothing is stored."""
    rig = rig_from_text(rig_row_of(core, rig_id).text, "rig")
    with _as_text(core, body) as path:
        preview = previewed(path, rig, form.recipe())
        return replace(preview, fault=preview.fault.replace(f"{path.parent}/", ""))


@contextmanager
def _as_text(core: Core, body: bytes) -> Iterator[Path]:
    """A file with a body that must be text."""
    with tempfile.TemporaryDirectory(dir=core.scratch()) as folder:
        path = Path(folder) / "readings.csv"
        path.write_bytes(body)
        if kind_of(path) != "text":  # libraries for other files are not made for what strangers send
            raise Problem(415, "body", "must be text; export the table as CSV")
        yield path


@router.post(
    "/import-csv",
    status_code=201,
    openapi_extra=documented_body("text/csv", "Readings, units in the header."),
)
def import_csv(
    change: ChangeOf,
    rig_id: RigId,
    body: Csv,
    turn: Importing,  # noqa: ARG001
    form: Annotated[Form, Query()],
) -> SessionInfo:
    """Make a closed session of a table of readings; what is not a readings CSV has to be accepted with `accept=true`."""
    core = change.core
    rig = rig_from_text(rig_row_of(core, rig_id).text, "rig")
    with _as_text(core, body) as path:
        read = understood(path, rig, form.recipe())
        if read.proposal is not None and not form.accept:
            meaning = ", ".join(f"{each.header!r} is {each.name}" for each in read.proposal.assigned)
            rule = f"must be accepted with accept=true, for the table is no readings CSV: {meaning}"
            raise Problem(422, "what was understood", rule, place="query accept")
        check_length(len(read.readings.observations), core.settings.most_readings)
        return _stored(change, Session(rig, *read.readings), rig_id)


@router.post(
    "/import-zip",
    status_code=201,
    openapi_extra=documented_body("application/zip", "A session.zarr, its files at the top of the archive."),
)
def import_zip(change: ChangeOf, rig_id: RigId, body: Zip, turn: Importing) -> SessionInfo:  # noqa: ARG001
    """Make a closed session of a zipped session.zarr, whose coils, sensors and movers must be those of the rig."""
    core = change.core
    rig = rig_from_text(rig_row_of(core, rig_id).text, "rig")
    limits = int(core.settings.most_unpacked_MB * 1e6), core.settings.most_readings
    with unpacked_session(body, core.scratch() / new_id(), *limits) as session:
        session.check_rig(rig)
        return _stored(change, session, rig_id)


def _stored(change: Change, session: Session, rig_id: str) -> SessionInfo:
    """Store a whole session under a new id; the row is committed last."""
    core, session_id = change.core, new_id()
    try:
        path = core.sessions.path(session_id)
        session.save(path)
        for part in (*path.rglob("*"), path, path.parent):  # on disk before it is acknowledged
            sync(part)
        with core.database.writing() as db:
            row = SessionRow(
                id=session_id,
                rig_id=rig_id,
                source=session.source,
                state=CLOSED,
                created=now(),
                user=change.caller.user,
                n_readings=len(session.observations),
                hash=session.hash,
                measured=session.created,
            )
            db.add(row)
            change.note(db, "session.import", session_id)
            return shown_as(SessionInfo, row)
    except BaseException:
        core.sessions.remove(session_id)
        raise
