"""Sessions of an inbox: complete ones, damaged ones, and those still being measured or copied."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from estimator.errors import CoilcalError, CorruptStore, reason
from estimator.given_files import MOST_TABLE_BYTES, open_given
from estimator.recalibration import policy
from estimator.store.session import Session, is_growing, load_session

GROWING = "it is still being measured, or its measurement was abandoned"
BEING_COPIED = "it cannot be read and changed less than a minute ago: it may still be being copied"
BLOCK_BYTES = 1_000_000  # that are hashed at once
CHANGED = "it changed while other sessions were judged"


@dataclass(frozen=True)
class Arrival:
    """One session of an inbox; `fault` says why it cannot be read."""

    path: Path
    taken: str
    hash: str
    fault: str = ""

    def session(self) -> Session | None:
        """The session; None if it has changed since it was found."""
        try:
            session = load_session(self.path)
        except (CoilcalError, OSError):
            return None
        return session if session.hash == self.hash else None


def arrivals(inbox: Path) -> tuple[list[Arrival], dict[Path, str]]:
    """The sessions of an inbox, oldest readings first, and the reasons why others must wait for the next run."""
    arrived, waiting = [], {}
    for path in sorted(inbox.glob("*.zarr")):
        try:
            if is_growing(path):
                waiting[path] = GROWING
                continue
            session = load_session(path)
            arrived.append(Arrival(path, _utc(datetime.fromisoformat(session.created)), session.hash))
        except (CoilcalError, ValueError, OSError) as error:
            try:
                if time.time() - _changed_s(path) < policy.SETTLED_S:
                    waiting[path] = BEING_COPIED
                else:
                    written = datetime.fromtimestamp(path.stat().st_mtime, UTC)
                    arrived.append(Arrival(path, _utc(written), _hash_of_files(path), reason(error)))
            except FileNotFoundError:
                continue  # it was taken away meanwhile
    return sorted(arrived, key=lambda arrival: arrival.taken), waiting


def _utc(time: datetime) -> str:
    """ISO time in UTC, so that times sort as text; a time without a zone is local."""
    return time.astimezone(UTC).isoformat(timespec="seconds")


def _changed_s(path: Path) -> float:
    """Time of the last change of any file (ctime, which a copy changes even if it preserves the time of writing)."""
    return max(part.lstat().st_ctime for part in _parts(path))


def _hash_of_files(path: Path) -> str:
    """SHA-256 over names and contents; with the name, so that two empty folders differ."""
    result = hashlib.sha256(path.name.encode())
    for part in _parts(path):
        result.update(str(part.relative_to(path)).encode())
        try:
            if part.is_file():
                with open_given(part, MOST_TABLE_BYTES, CorruptStore) as file:
                    while block := file.read(BLOCK_BYTES):
                        result.update(block)
        except (OSError, CorruptStore) as error:
            result.update(reason(error).encode())
    return result.hexdigest()


def _parts(path: Path) -> Iterator[Path]:
    yield path
    yield from sorted(path.rglob("*"))
