"""Logins of browsers: each is a row, which goes at the logout, so that a cookie that was copied before is worth nothing after it.

The cookie of the page names a login and is signed, so that the token itself does not stay in the browser. It is sent by this page alone
(`SameSite=Strict`) and no script can read it (`HttpOnly`). It ends with the login or its token, and after a month.
"""

from __future__ import annotations

import hashlib
import secrets
from datetime import UTC, datetime, timedelta
from pathlib import Path

from itsdangerous import BadSignature, TimestampSigner
from sqlalchemy import delete, select
from sqlalchemy.orm import Session
from starlette.requests import cookie_parser
from starlette.responses import Response

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


KEY_FILE = "page.key"
MOST_AGE_S = 30 * 24 * 3600


class Cookies:
    """Makes and reads the cookies of one service.

    Args:
        data: Its folder, which keeps the key; without the key file all have to log in again.
    """

    def __init__(self, data: Path) -> None:
        path = data / KEY_FILE
        if not path.exists():
            path.touch(mode=0o600)
            path.write_text(secrets.token_hex(32), encoding="ascii")
        key = path.read_text(encoding="ascii")
        self._signer = TimestampSigner(key, salt="coilcal page", digest_method=hashlib.sha256)
        # A browser sends cookies to every port of a host, so that two services there must not share a name.
        self.name = f"coilcal_{hashlib.sha256(key.encode()).hexdigest()[:8]}"

    def put(self, response: Response, login_id: str, is_secure: bool) -> None:
        """Log in the browser that receives a response."""
        value = self._signer.sign(login_id).decode()
        response.set_cookie(
            self.name, value, max_age=MOST_AGE_S, secure=is_secure, httponly=True, samesite="strict"
        )

    def remove(self, response: Response, is_secure: bool) -> None:
        """Log out the browser that receives a response."""
        response.delete_cookie(self.name, secure=is_secure, httponly=True, samesite="strict")

    def login_id(self, header: str) -> str | None:
        """The id of the login that a header `Cookie` stands for; None if it has no cookie of ours, or one that is too old."""
        try:
            return self._signer.unsign(cookie_parser(header).get(self.name, ""), max_age=MOST_AGE_S).decode()
        except BadSignature:
            return None
