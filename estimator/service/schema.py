"""Tables of the service: what must survive besides readings and posteriors, which are zarr in folders.

A change here needs a migration in `migrations/versions`; a test compares the two.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import JSON, ForeignKey, Index, MetaData, UniqueConstraint
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

# SQLite cannot alter what has no name.
NAMES = {
    "ix": "ix_%(column_0_label)s",
    "uq": "uq_%(table_name)s_%(column_0_name)s",
    "fk": "fk_%(table_name)s_%(column_0_name)s",
    "pk": "pk_%(table_name)s",
}


class Base(DeclarativeBase):
    """Base of all tables. Times are ISO 8601 in UTC, ids are made by the service."""

    metadata = MetaData(naming_convention=NAMES)


class Made(Base):
    """A row that belongs to a user."""

    __abstract__ = True

    id: Mapped[str] = mapped_column(primary_key=True)
    created: Mapped[str]
    user: Mapped[str]


class Labelled:
    """What people call a row: a name, a note, and tags with blanks between."""

    name: Mapped[str | None]
    note: Mapped[str | None]
    tags: Mapped[str | None]


class Token(Made):
    """Permission to use the service; the token itself is never stored, only its SHA-256."""

    __tablename__ = "tokens"

    scope: Mapped[str]
    hash: Mapped[str] = mapped_column(unique=True)
    expires: Mapped[str]
    revoked: Mapped[str | None]


class Login(Base):
    """A browser that is logged in with a token; the row goes at the logout."""

    __tablename__ = "logins"

    id: Mapped[str] = mapped_column(primary_key=True)
    token_id: Mapped[str] = mapped_column(ForeignKey("tokens.id"))
    created: Mapped[str] = mapped_column(index=True)


class RigVersion(Made):
    """The text of a rig file; versions with one name are versions of one rig."""

    __tablename__ = "rig_versions"

    name: Mapped[str] = mapped_column(index=True)
    hash: Mapped[str] = mapped_column(unique=True)
    text: Mapped[str]


class SessionRow(Labelled, Made):
    """A session; its readings lie in the folder of its id."""

    __tablename__ = "sessions"
    __table_args__ = (Index("ix_sessions_key", "user", "idempotency_key", unique=True),)

    rig_id: Mapped[str] = mapped_column(ForeignKey("rig_versions.id"), index=True)
    source: Mapped[str]
    state: Mapped[str]
    n_readings: Mapped[int | None]
    hash: Mapped[str | None] = mapped_column(index=True)
    idempotency_key: Mapped[str | None]
    measured: Mapped[str | None]


class Job(Labelled, Base):
    """Work that was asked for; its folder of the same id is its state."""

    __tablename__ = "jobs"
    __table_args__ = (
        UniqueConstraint("user", "idempotency_key", name="uq_jobs_key"),
        Index("ix_jobs_queue", "state", "number"),
    )

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(unique=True)
    user: Mapped[str] = mapped_column(index=True)
    kind: Mapped[str]
    state: Mapped[str]
    session_id: Mapped[str] = mapped_column(ForeignKey("sessions.id"), index=True)
    rig_id: Mapped[str | None] = mapped_column(ForeignKey("rig_versions.id"))
    options: Mapped[dict[str, Any]] = mapped_column(JSON)
    idempotency_key: Mapped[str | None]
    created: Mapped[str]
    started: Mapped[str | None]
    ended: Mapped[str | None]
    starts: Mapped[int]
    fault: Mapped[str | None]


class CalibrationRow(Made):
    """A calibration that a job has made."""

    __tablename__ = "calibrations"

    job_id: Mapped[str] = mapped_column(ForeignKey("jobs.id"), unique=True)
    session_id: Mapped[str] = mapped_column(ForeignKey("sessions.id"), index=True)
    rig_name: Mapped[str] = mapped_column(index=True)


class Webhook(Made):
    """An address that gets messages, with the secret that signs them."""

    __tablename__ = "webhooks"

    url: Mapped[str]
    secret: Mapped[str]


class Delivery(Base):
    """A message for a webhook, and what became of it."""

    __tablename__ = "deliveries"
    __table_args__ = (Index("ix_deliveries_due", "state", "next_attempt"),)

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    id: Mapped[str] = mapped_column(unique=True)
    webhook_id: Mapped[str] = mapped_column(ForeignKey("webhooks.id"), index=True)
    event: Mapped[str]
    body: Mapped[str]
    created: Mapped[str]
    state: Mapped[str]
    attempts: Mapped[int]
    next_attempt: Mapped[str | None]
    status: Mapped[int | None]
    fault: Mapped[str | None]
    ended: Mapped[str | None]


class Schedule(Made):
    """When the new sessions of a rig are judged: by a cron expression, or every so many seconds."""

    __tablename__ = "schedules"

    rig_name: Mapped[str]
    cron: Mapped[str | None]
    every_s: Mapped[int | None]
    timezone: Mapped[str]
    seed: Mapped[int]
    next_run: Mapped[str] = mapped_column(index=True)
    last_run: Mapped[str | None]
    is_at_work: Mapped[bool]


class Audit(Base):
    """Who changed what, and when; written in the transaction of the change itself."""

    __tablename__ = "audit"

    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    time: Mapped[str] = mapped_column(index=True)
    user: Mapped[str]
    token_id: Mapped[str | None]
    request_id: Mapped[str]
    action: Mapped[str]
    target: Mapped[str]
