"""Answers: rows as the API shows them, pages of lists, files, and ETags."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar

from fastapi import Depends, Query, Request
from pydantic import BaseModel
from sqlalchemy import ColumnElement, select, tuple_
from sqlalchemy.orm import Session
from starlette.responses import HTMLResponse, Response

from estimator.service.problems import Problem, not_found
from estimator.service.requests import BINARY, CoreOf
from estimator.service.schema import Base

MOST_ITEMS, ITEMS = 500, 50
Item = TypeVar("Item")
Shape = TypeVar("Shape", bound=BaseModel)
Row = TypeVar("Row", bound=Base)


class Page(BaseModel, Generic[Item]):
    """A part of a list, newest first; `next` is the cursor of the part that follows, null after the last one."""

    items: list[Item]
    next: str | None


Limit = Annotated[int, Query(ge=1, le=MOST_ITEMS, description="Items of a page.")]
Search = Annotated[
    str | None, Query(max_length=200, description="Words that name, note, tags or the like must contain.")
]
Cursor = Annotated[str | None, Query(max_length=200, description="`next` of the page before.")]


@dataclass(frozen=True)
class Listing:
    """Which part of a list is asked for."""

    core: CoreOf
    limit: Limit = ITEMS
    cursor: Cursor = None

    def page(
        self, table: Any, shape: type[Shape], *where: ColumnElement[bool], **equal: str | None
    ) -> Page[Shape]:
        """A page of the rows of a table, which has `created` and `id`.

        Args:
            table: Its class.
            shape: Rows as the API shows them.
            where: Conditions that rows must fulfil.
            equal: Values of columns that rows must have; None admits all.
        """
        key = tuple_(table.created, table.id)
        asked = {name: value for name, value in equal.items() if value is not None}
        rows = select(table).filter_by(**asked).where(*where)
        if self.cursor is not None:
            rows = rows.where(key < _key(self.cursor))
        rows = rows.order_by(table.created.desc(), table.id.desc()).limit(self.limit + 1)
        with self.core.database.reading() as db:
            records = list(db.scalars(rows))
        last = records[self.limit - 1] if len(records) > self.limit else None
        following = None
        if last is not None:
            following = base64.urlsafe_b64encode(f"{last.created} {last.id}".encode()).decode()
        return Page(items=[shown_as(shape, row) for row in records[: self.limit]], next=following)


ListingOf = Annotated[Listing, Depends()]


def shown_as(shape: type[Shape], row: object) -> Shape:
    """A row as the API shows it."""
    return shape.model_validate(row, from_attributes=True)


def row_of(db: Session, table: type[Row], row_id: str, thing: str) -> Row:
    """A row that must be there.

    Args:
        db: The database.
        table: The class of the row, which has `id`.
        row_id: Its id.
        thing: What it is, for the refusal.
    Raises:
        Problem: It is not there.
    """
    columns: Any = table
    row = db.scalar(select(table).where(columns.id == row_id))
    if row is None:
        raise not_found(thing, row_id)
    return row


def _key(cursor: str) -> tuple[str, str]:
    try:
        created, _, row_id = base64.urlsafe_b64decode(cursor).decode().partition(" ")
    except (binascii.Error, ValueError) as error:
        raise Problem(422, "cursor", "must be the `next` of a page", cursor, "query") from error
    return created, row_id


PAGE_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; sandbox"
"""Content-Security-Policy of reports, which are one file with their style and pictures inside; nothing in them may run."""

UNCHANGED: dict[int | str, dict[str, Any]] = {304: {"description": "It has not changed."}}


def file_of(media_type: str, schema: Mapping[str, Any] = BINARY) -> dict[str, Any]:
    """Arguments of a route that answers with a file, which a client need not load again while it has not changed."""
    return {
        "response_class": Response,
        "responses": {200: {"content": {media_type: {"schema": dict(schema)}}}, **UNCHANGED},
    }


def with_etag(request: Request, tag: str, answer: Callable[[], Response]) -> Response:
    """An answer that a client need not load again while its tag is the same."""
    quoted = f'"{tag}"'
    known = [part.strip().removeprefix("W/") for part in request.headers.get("if-none-match", "").split(",")]
    response = Response(status_code=304) if quoted in known or "*" in known else answer()
    response.headers["ETag"] = quoted
    return response


def file_with_etag(
    request: Request, tag: str, content: Callable[[], bytes], name: str, media_type: str
) -> Response:
    """A file that a browser saves under a name."""
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return with_etag(request, tag, lambda: Response(content(), headers=headers, media_type=media_type))


def page_with_etag(request: Request, tag: str, page: Callable[[], str]) -> Response:
    """A page of a report, in which nothing may run."""
    answer = with_etag(request, tag, lambda: HTMLResponse(page()))
    answer.headers["Content-Security-Policy"] = (
        PAGE_POLICY  # on 304 too, whose headers replace those of the copy
    )
    return answer
