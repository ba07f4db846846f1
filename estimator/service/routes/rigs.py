"""Rigs: the text of a rig file, checked before it is kept; a changed text is another version."""

from __future__ import annotations

import hashlib
from typing import Annotated

from fastapi import Depends, Query, Request
from pydantic import BaseModel
from sqlalchemy import select
from starlette.responses import Response

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.service.answers import ListingOf, Page, file_of, row_of, shown_as, with_etag
from estimator.service.core import Core
from estimator.service.database import new_id, now
from estimator.service.requests import ChangeOf, CoreOf, Id, documented_body, raw_body, router_of
from estimator.service.schema import RigVersion

YAML = ("application/yaml", "application/x-yaml", "text/yaml")
router = router_of("/v1/rigs", "rigs")
Text = Annotated[bytes, Depends(raw_body(*YAML))]
BODY = documented_body("application/yaml", "Text of a rig file.")


class RigInfo(BaseModel):
    """A version of a rig; `hash` is the SHA-256 of its text."""

    id: str
    name: str
    hash: str
    created: str
    user: str


class RigContent(BaseModel):
    """What a rig file describes."""

    name: str
    coils: list[str]
    sensors: list[str]
    movers: list[str]
    free_parameters: list[str]


def content_of(rig: Rig) -> RigContent:
    """Names of what a rig has."""
    return RigContent(
        name=rig.name,
        coils=[coil.name for coil in rig.coils],
        sensors=[sensor.name for sensor in rig.sensors],
        movers=[mover.name for mover in rig.movers],
        free_parameters=[parameter.name for parameter in rig.free],
    )


def rig_of(body: bytes) -> tuple[Rig, str]:
    """The rig of a body and its text.

    Raises:
        InvalidInput: It is no rig file.
    """
    try:
        text = body.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InvalidInput("body must be text in UTF-8; received other bytes (body)") from error
    return rig_from_text(text, "body"), text


def rig_row_of(core: Core, rig_id: str) -> RigVersion:
    """A version of a rig that must be there."""
    with core.database.reading() as db:
        return row_of(db, RigVersion, rig_id, "rig")


@router.post(
    "",
    status_code=201,
    openapi_extra=BODY,
    responses={200: {"model": RigInfo, "description": "It was there."}},
)
def upload_rig(response: Response, change: ChangeOf, body: Text) -> RigInfo:
    """Keep a rig file. The same text again is the same version."""
    rig, text = rig_of(body)
    digest = hashlib.sha256(text.encode()).hexdigest()
    with change.core.database.writing() as db:
        row = db.scalar(select(RigVersion).where(RigVersion.hash == digest))
        if row is None:
            row = RigVersion(id=new_id(), name=rig.name, hash=digest, text=text, created=now())
            row.user = change.caller.user
            db.add(row)
            change.note(db, "rig.upload", row.id)
        else:
            response.status_code = 200
        return shown_as(RigInfo, row)


@router.post("/validate", openapi_extra=BODY)
def validate_rig(body: Text) -> RigContent:
    """Check a rig file without keeping it."""
    return content_of(rig_of(body)[0])


@router.get("")
def list_rigs(
    listing: ListingOf,
    name: Annotated[
        str | None, Query(max_length=200, description="Versions of the rig of this name only.")
    ] = None,
) -> Page[RigInfo]:
    """Versions of rigs, newest first."""
    return listing.page(RigVersion, RigInfo, name=name)


@router.get("/{rig_id}")
def get_rig(core: CoreOf, rig_id: Id) -> RigInfo:
    """One version of a rig."""
    return shown_as(RigInfo, rig_row_of(core, rig_id))


@router.get("/{rig_id}/text", **file_of("application/yaml", {"description": "A rig file."}))
def get_rig_text(request: Request, core: CoreOf, rig_id: Id) -> Response:
    """The text of a rig file, as it was uploaded."""
    row = rig_row_of(core, rig_id)
    return with_etag(request, row.hash, lambda: Response(row.text, media_type="application/yaml"))
