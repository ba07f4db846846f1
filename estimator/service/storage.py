"""What the system refuses to the service itself, such as room on a full disk: no fault of a request, so that it can be sent again.

A request that fails so is answered with 507 or 503, never with 422, which a client takes as final.
"""

from __future__ import annotations

import errno
import math
import os
import sqlite3
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from estimator.errors import reason
from estimator.service.problems import Problem

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
# May end by itself (files that are open, memory), or be repaired by the administrator.
NO_ACCESS = frozenset(
    {errno.EROFS, errno.EIO, errno.EACCES, errno.EPERM, errno.EMFILE, errno.ENFILE, errno.ENOMEM}
)
OF_SQLITE: Mapping[int, int] = {
    sqlite3.SQLITE_FULL: errno.ENOSPC,
    sqlite3.SQLITE_READONLY: errno.EROFS,
    sqlite3.SQLITE_IOERR: errno.EIO,
    sqlite3.SQLITE_CANTOPEN: errno.EACCES,
}
PRIMARY = 0xFF  # the part of an extended code of SQLite that names its kind
RETRY_AFTER_S = 30
PROBE = "probe"  # file of the data folder that is written to see whether one can be
PROBE_BYTES = 4096
LEAST_FREE_BYTES = 16_000_000  # a request brings 32 MB at most, and most far less
PROBE_EVERY_S = 1.0


def shortage(error: BaseException) -> Problem | None:
    """The answer to a request that failed because the system refused something to the service; None for any other failure.

    Args:
        error: What was raised, with its causes.
    """
    for cause in _causes(error):
        code = _code(cause)
        if code in NO_ROOM or code in NO_ACCESS:
            return _problem(code, os.strerror(code))
    return None


class Storage:
    """Whether the data folder can be written.

    Args:
        data: The data folder.
    """

    def __init__(self, data: Path) -> None:
        self._data, self._lock = data, threading.Lock()
        self._asked_s = -math.inf
        self._answer: Problem | None = None

    @property
    def fault(self) -> Problem | None:
        """Why it cannot be written now; None if it can. The disk is asked once a second at most, however many ask."""
        with self._lock:
            if time.monotonic() - self._asked_s >= PROBE_EVERY_S:
                self._answer, self._asked_s = self._probed(), time.monotonic()
            return self._answer

    def _probed(self) -> Problem | None:
        path = self._data / PROBE
        try:
            disk = os.statvfs(self._data)
            free_bytes = disk.f_bavail * disk.f_frsize
            if free_bytes < LEAST_FREE_BYTES:
                return _problem(errno.ENOSPC, f"{free_bytes / 1e6:.1f} MB are free")
            try:
                with path.open("wb") as file:
                    file.write(bytes(PROBE_BYTES))
                    file.flush()
                    os.fsync(file.fileno())
            finally:
                path.unlink(missing_ok=True)
        except OSError as error:
            return _problem(error.errno or errno.EIO, reason(error))
        return None


def _problem(code: int, why: str) -> Problem:
    headers = {"Retry-After": str(RETRY_AFTER_S)}
    if code in NO_ROOM:
        return Problem(507, "service", f"must have room on its disk; it has none: {why}", headers=headers)
    return Problem(503, "service", f"must be able to write its data; it is not: {why}", headers=headers)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """An error and what it was raised from; SQLAlchemy keeps that in `orig` too."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        yield error
        error = error.__cause__ or (None if error.__suppress_context__ else error.__context__)


def _code(error: BaseException) -> int | None:
    """The `errno` of an error of the system or of SQLite."""
    if isinstance(error, OSError):
        return error.errno
    if isinstance(error, sqlite3.Error):
        code = getattr(error, "sqlite_errorcode", None)
        return None if code is None else OF_SQLITE.get(code & PRIMARY)
    return None
