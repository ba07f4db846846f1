"""What lies in an inbox: sessions that are whole, some that are damaged, and some that are still on their way."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from estimator.errors import CoilcalError, reason
from estimator.recalibration import policy
from estimator.store.session import Session, is_growing, load_session

GROWING = "it is still being measured, or was left before its end"
ON_ITS_WAY = "it cannot be read and changed less than a minute ago, as if it were being copied"
CHANGED = "it changed while others were judged"


@dataclass(frozen=True)
class Arrival:
    """One session of an inbox; `fault` says why it cannot be read."""

    path: Path
    taken: str
    hash: str
    fault: str = ""

    def session(self) -> Session | None:
        """The readings; None where they are no longer those that arrived."""
        try:
            session = load_session(self.path)
        except (CoilcalError, OSError):
            return None
        return session if session.hash == self.hash else None


def arrivals(inbox: Path) -> tuple[list[Arrival], dict[Path, str]]:
    """The sessions of an inbox, oldest readings first, and why others have to wait for the next time."""
    found, waiting = [], {}
    for path in sorted(inbox.glob("*.zarr")):
        try:
            if is_growing(path):
                waiting[path] = GROWING
                continue
            session = load_session(path)
            found.append(Arrival(path, _utc(datetime.fromisoformat(session.created)), session.hash))
        except (CoilcalError, ValueError, OSError) as error:
            try:
                if time.time() - _changed_s(path) < policy.SETTLED_S:
                    waiting[path] = ON_ITS_WAY
                else:
                    written = datetime.fromtimestamp(path.stat().st_mtime, UTC)
                    found.append(Arrival(path, _utc(written), _hash_of_files(path), reason(error)))
            except FileNotFoundError:
                continue  # it was taken away meanwhile
    return sorted(found, key=lambda arrival: arrival.taken), waiting


def _utc(time: datetime) -> str:
    """In one time zone, so that the text sorts; a time without a zone is that of the room."""
    return time.astimezone(UTC).isoformat(timespec="seconds")


def _changed_s(path: Path) -> float:
    """When anything of it last changed here; copies that keep the time of writing change this one all the same."""
    return max(part.lstat().st_ctime for part in _parts(path))


def _hash_of_files(path: Path) -> str:
    """SHA-256 over name and content, that two different things with nothing in them are told apart."""
    result = hashlib.sha256(path.name.encode())
    for part in _parts(path):
        result.update(str(part.relative_to(path)).encode())
        try:
            result.update(part.read_bytes() if part.is_file() else b"")
        except OSError as error:
            result.update(reason(error).encode())
    return result.hexdigest()


def _parts(path: Path) -> Iterator[Path]:
    yield path
    yield from sorted(path.rglob("*"))
