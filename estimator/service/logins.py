"""Logins of browsers: each is a row, which goes at the logout, so that a cookie that was copied before is worth nothing after it."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from estimator.service.cookies import MOST_AGE_S
from estimator.service.database import Database, new_id, now
from estimator.service.schema import Login, Token
from estimator.service.tokens import Caller, caller_of_row


def begin_login(db: Session, token_id: str) -> str:
    """The id of a new login with a token; logins with an expired cookie are deleted."""
    oldest = datetime.now(UTC) - timedelta(seconds=MOST_AGE_S)
    db.execute(delete(Login).where(Login.created < oldest.isoformat(timespec="milliseconds")))
    login = Login(id=new_id(), token_id=token_id, created=now())
    db.add(login)
    return login.id


def end_login(db: Session, login_id: str) -> str | None:
    """End a login; the id of its token, None if there was no such login."""
    login = db.get(Login, login_id)
    if login is None:
        return None
    db.delete(login)
    return login.token_id


def caller_of_login(database: Database, login_id: str) -> Caller | None:
    """The caller of a login; None if it has ended, or its token has expired or is revoked."""
    with database.reading() as db:
        row = db.scalar(select(Token).join(Login, Login.token_id == Token.id).where(Login.id == login_id))
    return caller_of_row(row)
