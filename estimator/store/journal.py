"""A journal: a file of entries, one line each, to which entries are only appended; each is on disk before `append` returns.

A line is a CRC-32, and JSON that holds the number of the line. A crash can tear only the last line, which was never reported as written:
it is dropped. Any other line that does not match is damage. One process writes, under a lock that the system releases when the process
ends; any number of processes may read meanwhile.
"""

from __future__ import annotations

import fcntl
import json
import os
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

from estimator.errors import CorruptStore, InvalidInput
from estimator.given_files import MOST_TABLE_BYTES, read_given
from estimator.json_files import json_object
from estimator.store.files import unwritable, writing
from estimator.store.made import JOURNAL
from estimator.store.staging import staged

Entry: TypeAlias = dict[str, Any]


class Journal:
    """The only writer of a journal; leaving its `with` block admits another one.

    Attributes:
        header: First entry, which describes the others.
        entries: All others, in order.

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
        self.header: Entry = {}
        self.entries: list[Entry] = []
        self._n_lines, self._end = 0, 0

    @classmethod
    def create(cls, folder: Path, header: Mapping[str, Any]) -> Journal:
        """Begin a journal in a new folder.

        Raises:
            InvalidInput: The folder exists, or cannot be written.
        """
        folder = folder.absolute()
        journal = None
        try:
            with staged(folder) as new:
                new.mkdir()
                descriptor = os.open(new / JOURNAL, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)
                journal = cls(descriptor, folder / JOURNAL)
                _lock(descriptor, new / JOURNAL)
                journal._write([header])
        except BaseException:
            if journal is not None:
                journal.close()
            raise
        journal.header = dict(header)
        return journal

    @classmethod
    def resume(cls, folder: Path) -> Journal:
        """Continue a journal; a torn last line is cut off.

        Raises:
            InvalidInput: Another process writes the journal, or there is none.
            CorruptStore: A line is damaged.
        """
        path = folder / JOURNAL
        with writing(path, "session"):
            descriptor = os.open(path, os.O_RDWR)
        journal = cls(descriptor, path)
        try:
            _lock(descriptor, path)
            entries, journal._end = _parsed(path)
            journal.header, *journal.entries = entries
            journal._n_lines = len(entries)
            os.ftruncate(descriptor, journal._end)
            os.pwrite(descriptor, b"\n", journal._end - 1)  # in case a crash lost only the line feed
        except OSError as error:
            journal.close()
            raise unwritable(path, error, "session") from error
        except BaseException:
            journal.close()
            raise
        return journal

    def append(self, entry: Mapping[str, Any]) -> None:
        """Write an entry; once this returns, it is on disk.

        Raises:
            InvalidInput: The entry cannot be written; the journal is unchanged, or closed.
        """
        self._write([entry])
        self.entries.append(dict(entry))

    def append_all(self, entries: Sequence[Mapping[str, Any]]) -> None:
        """Write entries and wait once; when this returns, all are on disk.

        They are not kept in `entries`, so that memory does not grow in a session of hours. A crash leaves the first ones of
        them, or none.

        Raises:
            InvalidInput: They cannot be written; the journal is unchanged, or closed.
        """
        if entries:
            self._write(entries)

    def close(self) -> None:
        """Release the lock for another writer; a second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _write(self, entries: Sequence[Mapping[str, Any]]) -> None:
        try:
            lines = b"".join(
                _line(number, entry) for number, entry in enumerate(entries, start=self._n_lines)
            )
        except ValueError as error:  # of JSON, which has no infinity
            rule = f"session must hold finite numbers; {self._path.parent} would hold another"
            raise InvalidInput(rule) from error
        try:
            n_written = 0
            while n_written < len(lines):
                n_written += os.pwrite(self._descriptor, lines[n_written:], self._end + n_written)
            os.fsync(self._descriptor)
        except OSError as error:
            try:
                os.ftruncate(self._descriptor, self._end)
            except OSError:
                self.close()  # nothing may follow the remains of the line
            raise unwritable(self._path.parent, error, "session") from error
        self._end += len(lines)
        self._n_lines += len(entries)


@contextmanager
def unwritten(folder: Path) -> Iterator[None]:
    """Lock writers out of a journal for a block, which may delete it; does nothing if there is none.

    Raises:
        InvalidInput: A process writes the journal.
    """
    path = folder / JOURNAL
    if not path.is_file():
        yield
        return
    descriptor = os.open(path, os.O_RDWR)  # network drives lock only files opened for writing
    try:
        _lock(descriptor, path)
        yield
    finally:
        os.close(descriptor)


def read_journal(folder: Path) -> tuple[Entry, list[Entry]]:
    """Header and entries of a journal, which may grow meanwhile.

    Raises:
        CorruptStore: A line is damaged.
    """
    (header, *entries), _ = _parsed(folder / JOURNAL)
    return header, entries


def _lock(descriptor: int, path: Path) -> None:
    """Become the only writer of a file; refuse if the file is no longer the one at its path."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise InvalidInput(
            f"session must be written by one process at a time; another writes {path.parent}"
        ) from error
    if not path.is_file() or not os.path.samestat(os.fstat(descriptor), path.stat()):
        raise InvalidInput(f"session must be there while it is written; {path.parent} was removed")


def _line(number: int, entry: Mapping[str, Any]) -> bytes:
    text = json.dumps({"n": number, **entry}, allow_nan=False).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def _parsed(path: Path) -> tuple[list[Entry], int]:
    """All entries of a journal, including the header, and the offset of their end."""
    data = read_given(path, MOST_TABLE_BYTES, CorruptStore)
    last = data[data.rfind(b"\n") + 1 :]
    # A last line that lacks only its line feed is whole.
    entries, size = parsed_lines(data + b"\n" if _is_whole(last) else data, 0, path)
    if not entries:
        raise CorruptStore(f"session must begin with its header; {path} holds none")
    return entries, size


def parsed_lines(data: bytes, first: int, path: Path) -> tuple[list[Entry], int]:
    """Entries of the whole lines, and their length in bytes; bytes after the last line feed are torn, or still being written.

    Args:
        data: Bytes of a journal, from the beginning of a line.
        first: Number of that line.
        path: Path of the journal, for messages.
    Raises:
        CorruptStore: A line is damaged.
    """
    *lines, last = data.split(b"\n")
    if _is_whole(last[:-1]):  # the byte after a whole line was its line feed
        lines.append(last)
    entries = []
    for number, line in enumerate(lines, start=first):
        if not _is_whole(line):
            raise CorruptStore(f"session must match its checksums; line {number + 1} of {path} does not")
        entry = json_object(line.partition(b" ")[2], f"{path}, line {number + 1}", CorruptStore)
        if entry.pop("n", None) != number:
            raise CorruptStore(
                f"session must hold all its lines; line {number + 1} of {path} has another number"
            )
        entries.append(entry)
    return entries, sum(len(line) + 1 for line in lines)


def _is_whole(line: bytes) -> bool:
    checksum, _, text = line.partition(b" ")
    return checksum == b"%08x" % zlib.crc32(text)
