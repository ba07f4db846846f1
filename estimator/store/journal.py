"""A journal: records that are on the disk before anybody hears of them, one line each, in a file that only grows.

A line is its CRC-32, and JSON that holds its number. What a crash tears is the last line, which nobody was told of: it is dropped. Any
other line that does not fit is damage. One process writes, held by a lock that the system takes away when the process ends; any
number may read meanwhile.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, TypeAlias

from estimator.errors import CorruptStore, InvalidInput, reason

JOURNAL = "journal.jsonl"

Record: TypeAlias = dict[str, Any]


class Journal:
    """The writer; leaving its `with` block lets another one in.

    Attributes:
        header: First record, which says what the others belong to.
        records: All others, in order.

    Examples:
        >>> import tempfile
        >>> folder = Path(tempfile.mkdtemp()) / "session.zarr"
        >>> with Journal.create(folder, {"rig": "small"}) as journal:
        ...     journal.append({"field_T": 0.1})
        >>> read_journal(folder)
        ({'rig': 'small'}, [{'field_T': 0.1}])
    """

    def __init__(self, descriptor: int, path: Path) -> None:
        self._descriptor, self._path = descriptor, path
        self.header: Record = {}
        self.records: list[Record] = []
        self._end = 0

    @classmethod
    def create(cls, folder: Path, header: Mapping[str, Any]) -> Journal:
        """Begin a journal in a folder that is not there yet.

        Raises:
            InvalidInput: It is there, or cannot be written.
        """
        folder = folder.absolute()
        begun = folder.with_name(folder.name + ".begun")
        path = begun / JOURNAL
        try:
            with unwritten(begun):
                shutil.rmtree(begun, ignore_errors=True)
            begun.mkdir(parents=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
        except OSError as error:
            raise InvalidInput(f"output must be writable; {folder} is not: {reason(error)}") from error
        journal = cls(descriptor, folder / JOURNAL)
        try:
            _lock(descriptor, path)
            journal._write(header)
            sync(begun)
            begun.rename(folder)  # now there is a session, and it has a header
            sync(folder.parent)
        except OSError as error:
            journal.close()
            raise InvalidInput(f"output must be writable; {folder} is not: {reason(error)}") from error
        except BaseException:
            journal.close()
            raise
        journal.header = dict(header)
        return journal

    @classmethod
    def resume(cls, folder: Path) -> Journal:
        """Go on with a journal; a torn last line is cut off.

        Raises:
            InvalidInput: Another process writes it, or there is none.
            CorruptStore: A line is damaged.
        """
        path = folder / JOURNAL
        try:
            descriptor = os.open(path, os.O_RDWR)
        except OSError as error:
            raise InvalidInput(f"session must be writable; {path} is not: {reason(error)}") from error
        journal = cls(descriptor, path)
        try:
            _lock(descriptor, path)
            entries, journal._end = _parsed(path)
            journal.header, *journal.records = entries
            os.ftruncate(descriptor, journal._end)
            os.pwrite(descriptor, b"\n", journal._end - 1)  # where a crash tore the line feed only
        except OSError as error:
            journal.close()
            raise InvalidInput(f"session must be writable; {path} is not: {reason(error)}") from error
        except BaseException:
            journal.close()
            raise
        return journal

    def append(self, record: Mapping[str, Any]) -> None:
        """Write a record; once this returns, it is on the disk.

        Raises:
            InvalidInput: It cannot be written; the journal is as it was, or takes no more.
        """
        self._write(record)
        self.records.append(dict(record))

    def close(self) -> None:
        """Let another writer in; a second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _write(self, record: Mapping[str, Any]) -> None:
        line = _line(len(self.records) + bool(self.header), record)
        try:
            done = 0
            while done < len(line):
                done += os.pwrite(self._descriptor, line[done:], self._end + done)
            os.fsync(self._descriptor)
        except OSError as error:
            try:
                os.ftruncate(self._descriptor, self._end)
            except OSError:
                self.close()  # nothing may follow what is left of the line
            raise InvalidInput(
                f"session must be writable; {self._path.parent} is not: {reason(error)}"
            ) from error
        self._end += len(line)


@contextmanager
def unwritten(folder: Path) -> Iterator[None]:
    """Keep writers out of a journal for a block, in which it may be taken away; does nothing where there is none.

    Raises:
        InvalidInput: A process writes it.
    """
    path = folder / JOURNAL
    if not path.is_file():
        yield
        return
    descriptor = os.open(path, os.O_RDWR)  # a network drive locks what may be written only
    try:
        _lock(descriptor, path)
        yield
    finally:
        os.close(descriptor)


def read_journal(folder: Path) -> tuple[Record, list[Record]]:
    """Header and records of a journal, which may grow meanwhile.

    Raises:
        CorruptStore: A line is damaged.
    """
    (header, *records), _ = _parsed(folder / JOURNAL)
    return header, records


def _lock(descriptor: int, path: Path) -> None:
    """Become the only writer of a file, as long as it is the one that stands at its path and was not taken away meanwhile."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise InvalidInput(
            f"session must be written by one process at a time; another writes {path.parent}"
        ) from error
    if not path.is_file() or not os.path.samestat(os.fstat(descriptor), path.stat()):
        raise InvalidInput(f"session must be there while it is written; {path.parent} was taken away")


def _line(number: int, record: Mapping[str, Any]) -> bytes:
    text = json.dumps({"n": number, **record}, allow_nan=False).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def _parsed(path: Path) -> tuple[list[Record], int]:
    """All records of a journal, the header among them, and where they end."""
    data = path.read_bytes()
    last = data[data.rfind(b"\n") + 1 :]
    # A line that lacks but its line feed is whole, for those who know that nobody is writing the rest of it.
    entries, size = parsed_lines(data + b"\n" if _is_whole(last) else data, 0, path)
    if not entries:
        raise CorruptStore(f"session must begin with its header; {path} holds none")
    return entries, size


def parsed_lines(data: bytes, first: int, path: Path) -> tuple[list[Record], int]:
    """Records of whole lines, and the length of these; what follows the last line feed is torn, or being written.

    Args:
        data: Of a journal, from the beginning of a line.
        first: Number of that line.
        path: For messages.
    Raises:
        CorruptStore: A line is damaged.
    """
    *lines, last = data.split(b"\n")
    if _is_whole(last[:-1]):  # what follows a whole line was its line feed
        lines.append(last)
    entries = []
    for number, line in enumerate(lines, start=first):
        if not _is_whole(line):
            raise CorruptStore(f"session must match its checksums; line {number + 1} of {path} does not")
        record = json.loads(line.partition(b" ")[2])
        if record.pop("n") != number:
            raise CorruptStore(f"session must hold all its lines; line {number + 1} of {path} is another one")
        entries.append(record)
    return entries, sum(len(line) + 1 for line in lines)


def _is_whole(line: bytes) -> bool:
    checksum, _, text = line.partition(b" ")
    return checksum == b"%08x" % zlib.crc32(text)


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
