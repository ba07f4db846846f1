"""Name, note and tags that people give to sessions and jobs, and by which they find them again."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field
from sqlalchemy import ColumnElement, func, or_

from estimator.service.answers import row_of
from estimator.service.requests import Change
from estimator.service.schema import Job, SessionRow

Tag = Annotated[str, Field(pattern=r"^[^\s,]{1,50}$")]


def _listed(stored: object) -> object:
    """Tags as a list; they are stored as words of one text."""
    return stored.split() if isinstance(stored, str) else stored or []


def _date(text: str) -> str:
    datetime.fromisoformat(text)
    return text


Tags = Annotated[list[Tag], BeforeValidator(_listed)]
Date = Annotated[str, AfterValidator(_date), Field(max_length=40, description="ISO 8601, a day or a time.")]


class Labelled(BaseModel):
    """What people call a session or a job."""

    name: str | None = None
    note: str | None = None
    tags: Tags = []


class Labels(BaseModel, extra="forbid"):
    """What to call a session or a job from now on; what is left out stays."""

    name: Annotated[str | None, Field(max_length=200)] = None
    note: Annotated[str | None, Field(max_length=5000)] = None
    tags: Annotated[list[Tag], Field(max_length=20)] = []


class SessionLabels(Labels):
    """What to call a session from now on, and when it was measured."""

    measured: Date | None = None


def relabelled(change: Change, table: type[Any], row_id: str, thing: str, labels: Labels) -> Any:
    """A row with its new labels, which are stored and in the audit.

    Args:
        change: The request.
        table: `SessionRow` or `Job`.
        row_id: Id of the row.
        thing: What it is, in words.
        labels: What was given of them.
    """
    with change.core.database.writing() as db:
        row = row_of(db, table, row_id, thing)
        for key, value in labels.model_dump(exclude_unset=True).items():
            setattr(row, key, " ".join(dict.fromkeys(value)) if key == "tags" else value or None)
        change.note(db, f"{thing}.label", row_id)
    return row


def containing(table: type[SessionRow | Job], text: str | None) -> list[ColumnElement[bool]]:
    """Conditions that a row has all words of a search in its labels, in what it is or in who made it.

    Args:
        table: Of the rows.
        text: Words, in any case; None admits all rows.
    """
    columns: list[Any] = [table.name, table.note, table.tags, table.user, table.id]
    columns.append(table.source if table is SessionRow else table.kind)  # type: ignore[union-attr]
    return [
        or_(*(func.lower(column).contains(word, autoescape=True) for column in columns))
        for word in (text or "").lower().split()
    ]
