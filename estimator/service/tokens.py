"""Tokens: made once, shown once, kept as a hash, and looked up by it.

A token holds 256 random bits, so SHA-256 is enough: nobody can try them all. Slow hashes are for words that people choose, and one would
cost every request a tenth of a second.
"""

from __future__ import annotations

import hashlib
import re
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum

from sqlalchemy import select

from estimator.errors import InvalidInput
from estimator.service.database import Database, new_id, now
from estimator.service.schema import Audit, Token

PREFIX = "coilcal_"
USER = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.@-]{0,63}")
LOCAL_USER = "local"
MOST_DAYS = 3650


class Scope(StrEnum):
    """What a token allows; each includes those before it."""

    READ = "read"
    WRITE = "write"
    ADMIN = "admin"

    def includes(self, other: Scope) -> bool:
        """Whether this scope allows what another one does."""
        order = list(Scope)
        return order.index(self) >= order.index(other)


@dataclass(frozen=True)
class Caller:
    """The caller of a request."""

    user: str
    scope: Scope
    token_id: str | None = None


NOBODY_ELSE = Caller(LOCAL_USER, Scope.ADMIN)
"""The caller where no tokens are needed, because only this computer reaches the service."""


def create_token(database: Database, user: str, scope: Scope, days: float) -> tuple[str, str]:
    """A new token and its id; the token itself cannot be had again.

    Raises:
        InvalidInput: The name has other characters than names have, or the time is out of range.
    """
    if not USER.fullmatch(user):
        raise InvalidInput(f"user must be letters, digits and _.@- (64 at most); received {user[:80]!r}")
    if not 0 < days <= MOST_DAYS:
        raise InvalidInput(f"days must be above 0 and at most {MOST_DAYS}; received {days:g}")
    secret = PREFIX + secrets.token_urlsafe(32)
    expires = datetime.now(UTC) + timedelta(days=days)
    row = Token(
        id=new_id()[:12],
        user=user,
        scope=scope,
        hash=_hash(secret),
        created=now(),
        expires=expires.isoformat(timespec="milliseconds"),
    )
    with database.writing() as db:
        db.add(row)
        db.add(_audit("token.create", row.id))
    return secret, row.id


def revoke_token(database: Database, token_id: str) -> None:
    """End a token now; a second call does nothing.

    Raises:
        InvalidInput: There is none of this id.
    """
    with database.writing() as db:
        row = db.get(Token, token_id)
        if row is None:
            raise InvalidInput(f"token must be the id of one that exists; received {token_id[:80]!r}")
        if row.revoked is None:
            row.revoked = now()
            db.add(_audit("token.revoke", row.id))


def all_tokens(database: Database) -> list[Token]:
    """All tokens, oldest first."""
    with database.reading() as db:
        return list(db.scalars(select(Token).order_by(Token.created)))


def caller_of(database: Database, secret: str) -> Caller | None:
    """The caller that a token belongs to; None if it is wrong, expired or revoked."""
    with database.reading() as db:
        return caller_of_row(db.scalar(select(Token).where(Token.hash == _hash(secret))))


def caller_of_row(row: Token | None) -> Caller | None:
    """The caller that a token belongs to; None if there is none, or it has expired or is revoked."""
    if row is None or row.revoked is not None or row.expires <= now():
        return None
    return Caller(row.user, Scope(row.scope), row.id)


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


def _audit(action: str, target: str) -> Audit:
    return Audit(time=now(), user="command line", request_id="", action=action, target=target)
