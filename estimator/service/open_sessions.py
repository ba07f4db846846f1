"""Sessions that take readings: one journal each, which only this process writes.

A reading is acknowledged once it is on disk. The number of a reading makes a repeated request harmless: what is there already is compared,
and not written again.
"""

from __future__ import annotations

import json
import math
import shutil
import threading
import zlib
from array import array
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from estimator.errors import CorruptStore
from estimator.rig.rig import Rig
from estimator.rig_files.state import rig_from_state
from estimator.service.problems import Problem
from estimator.service.readings import Reading
from estimator.store.growing import new_header
from estimator.store.journal import Journal
from estimator.store.session import Session, is_growing, load_session, seal

# Journals that stay open; those longest unused are closed, and opened again when they are needed.
MOST_IN_MEMORY = 256


@dataclass
class _Writer:
    """A journal that is open, with a checksum of each of its readings.

    The service remembers checksums instead of readings: four bytes each.
    """

    journal: Journal
    rig: Rig
    checksums: array[int]
    last_s: float
    lock: threading.Lock = field(default_factory=threading.Lock)


class OpenSessions:
    """Appends to the sessions below a folder, from any number of threads.

    Args:
        folder: Where sessions lie, each under its id.
        most_readings: Readings of one session.
    """

    def __init__(self, folder: Path, most_readings: int) -> None:
        self._folder, self._most_readings = folder, most_readings
        self._writers: OrderedDict[str, _Writer] = OrderedDict()
        self._lock = threading.Lock()

    def path(self, session_id: str) -> Path:
        """Folder of a session whose id the database holds."""
        return self._folder / f"{session_id}.zarr"

    def create(self, session_id: str, rig: Rig, source: str) -> None:
        """Begin a session without readings."""
        with Journal.create(self.path(session_id), new_header(rig, source, "", {})):
            pass

    def rig(self, session_id: str) -> Rig:
        """The rig of an open session."""
        with self._writer(session_id) as writer:
            return writer.rig

    def n_readings(self, session_id: str) -> int:
        """Readings of an open session that are on disk."""
        with self._writer(session_id) as writer:
            return len(writer.checksums)

    def append(self, session_id: str, readings: Sequence[Reading]) -> tuple[int, int]:
        """Write those readings that are not there yet; once this returns, all of them are on disk.

        Returns: Readings of the session, and how many of them are new.
        Raises:
            Problem: There is a gap before the first reading, another reading of the same number is there, or there are too many.
            InvalidInput: The disk is full, or cannot be written.
        """
        with self._writer(session_id) as writer:
            n = len(writer.checksums)
            if readings[0].sequence > n:
                raise Problem(
                    409, "sequence", f"must continue at {n}, where the session ends", readings[0].sequence
                )
            if readings[-1].sequence >= self._most_readings:
                rule = f"must have at most {self._most_readings} readings"
                raise Problem(409, "session", rule, readings[-1].sequence + 1)
            entries = [reading.entry(writer.rig) for reading in readings]
            checksums = [_checksum(entry) for entry in entries]
            for reading, checksum in zip(readings, checksums, strict=True):
                if reading.sequence < n and writer.checksums[reading.sequence] != checksum:
                    rule = "must be sent again as it was sent before; another reading has its number"
                    raise Problem(409, f"reading {reading.sequence}", rule)
            first = n - readings[0].sequence
            last_s = writer.last_s
            for reading in readings[first:]:
                if reading.time_s <= last_s:
                    rule = f"must be later than that of the reading before, {last_s:.15g}"
                    raise Problem(422, f"time_s of reading {reading.sequence}", rule, reading.time_s)
                last_s = reading.time_s
            try:
                writer.journal.append_all(entries[first:])
            except Exception:
                self._forget(session_id)  # its state on disk is read again before the next append
                raise
            writer.checksums.extend(checksums[first:])
            writer.last_s = last_s
            return len(writer.checksums), len(entries[first:])

    def seal(self, session_id: str) -> Session:
        """End a session: its readings become arrays. A session that was sealed before stays as it is."""
        path = self.path(session_id)
        if not is_growing(path):
            return load_session(path)
        with self._writer(session_id) as writer:
            if not writer.checksums:
                raise Problem(409, "session", "must hold a reading before it is closed; it holds none")
            session = seal(path)
            self._forget(session_id)
            return session

    def remove(self, session_id: str) -> None:
        """Delete a session, after the append that is under way; one that waits finds it closed."""
        writer = self._writers.get(session_id)
        with nullcontext() if writer is None else writer.lock:
            self._forget(session_id)
            shutil.rmtree(self.path(session_id), ignore_errors=True)

    def close(self) -> None:
        """Release all journals, each after the append that is under way."""
        for session_id in list(self._writers):
            with self._writer(session_id):
                self._forget(session_id)

    @contextmanager
    def _writer(self, session_id: str) -> Iterator[_Writer]:
        """The only use of a session's journal at a time."""
        while True:
            with self._lock:
                writer = self._writers.get(session_id)
                if writer is None:
                    writer = self._writers[session_id] = _open(self.path(session_id))
                self._writers.move_to_end(session_id)
                self._close_unused()
            with writer.lock:
                if self._writers.get(session_id) is writer:  # else it was closed while this one waited
                    yield writer
                    return

    def _close_unused(self) -> None:
        for session_id in list(self._writers)[: max(0, len(self._writers) - MOST_IN_MEMORY)]:
            writer = self._writers[session_id]
            if writer.lock.acquire(blocking=False):
                try:
                    self._forget(session_id)
                finally:
                    writer.lock.release()

    def _forget(self, session_id: str) -> None:
        writer = self._writers.pop(session_id, None)
        if writer is not None:
            writer.journal.close()


def _open(path: Path) -> _Writer:
    if not is_growing(path):
        raise Problem(409, "session", "must be open; it is closed")
    journal = Journal.resume(path)
    try:
        rig = rig_from_state(journal.header["rig"], "rig of the session")
        checksums = array("L", (_checksum(entry) for entry in journal.entries))
        last_s = float(journal.entries[-1]["time_s"]) if journal.entries else -math.inf
    except (KeyError, TypeError) as error:
        journal.close()
        raise CorruptStore(f"session must begin with its header; {path.name} does not") from error
    journal.entries = []
    return _Writer(journal, rig, checksums, last_s)


def _checksum(entry: Mapping[str, Any]) -> int:
    return zlib.crc32(json.dumps(entry, sort_keys=True).encode())
