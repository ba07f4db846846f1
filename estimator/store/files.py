"""Files that are whole or as before, even if the computer stops while one is written.

An unfinished file stands beside its place under a random name that did not exist before, so that no other file is opened, followed or
replaced on the way.
"""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from estimator.errors import DiskFull, InvalidInput, reason

LONGEST_NAME = 200  # bytes of a name that its unfinished file repeats; file systems take 255
UNFINISHED = re.compile(r"(\..+\.[0-9a-f]{16})([0-9a-f]{8})\.coilcal", re.DOTALL)
KINDS = (
    (stat.S_ISLNK, "a link"),
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISREG, "a file"),
)


def write_text(path: Path, text: str) -> None:
    """Replace a file by a text in UTF-8, atomically; errors as `write_bytes`."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes, scratch: Path | None = None) -> None:
    """Replace a file atomically; what fails leaves nothing behind.

    Args:
        path: The file; it need not exist.
        content: All that it will hold.
        scratch: Folder on the same disk for the unfinished file; that of `path` where none is given.
    Raises:
        InvalidInput: Something that is no file is at the path, such as a link or a device.
        OSError: It cannot be written; the error names `path`.
    """
    kind = kind_of(path)
    if kind not in (None, "a file"):
        raise InvalidInput(f"output must be a file; {path} is {kind}")
    unfinished = (scratch or path.parent) / unfinished_name(path.name)
    with naming(path):
        descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666)
        try:
            with os.fdopen(descriptor, "wb", buffering=0) as file:
                write_all(file.fileno(), content)
                os.fsync(file.fileno())
            unfinished.replace(path)
        except BaseException:
            with suppress(OSError):
                unfinished.unlink()
            raise


def append_text(path: Path, text: str) -> None:
    """Add lines to a file; once this returns, it is on disk. What fails leaves the file as it was.

    Raises:
        OSError: It cannot be written; the error names `path`.
    """
    with naming(path):
        descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            size = os.fstat(descriptor).st_size
            try:
                write_all(descriptor, text.encode())
                os.fsync(descriptor)
            except OSError:
                with suppress(OSError):
                    os.ftruncate(descriptor, size)
                raise
        finally:
            os.close(descriptor)


def write_all(descriptor: int, content: bytes) -> None:
    """Write every byte; the system may take fewer at a time."""
    left = memoryview(content)
    while left:
        left = left[os.write(descriptor, left) :]


def unfinished_name(name: str) -> str:
    """A name beside a file or folder while it is written; hidden, new at each call, and known again by a checksum in it.

    Examples:
        >>> is_unfinished(unfinished_name("s.zarr")), is_unfinished(".s.zarr.0123456789abcdef01234567.coilcal")
        (True, False)
    """
    begin = f"{unfinished_prefix(name)}{secrets.token_hex(8)}"
    return f"{begin}{_checksum(begin)}.coilcal"


def is_unfinished(name: str) -> bool:
    """Whether `unfinished_name` has given a name: only what has such a name is deleted where nothing else says whose it is."""
    parts = UNFINISHED.fullmatch(name)
    return parts is not None and _checksum(parts[1]) == parts[2]


def _checksum(begin: str) -> str:
    return f"{zlib.crc32(os.fsencode(begin)):08x}"


def unfinished_prefix(name: str) -> str:
    """How the names begin that `unfinished_name` gives for a file or folder."""
    return f".{name.encode(errors='surrogateescape')[:LONGEST_NAME].decode(errors='ignore')}."


def kind_of(path: Path) -> str | None:
    """What is at a path, in words, such as `a file`; links are not followed. None where nothing is."""
    try:
        mode = os.lstat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    return next((words for is_kind, words in KINDS if is_kind(mode)), "a device")


def real(path: Path) -> Path:
    """The path without links; where links lead in a circle, the path as it is."""
    return Path(os.path.realpath(path))


def sync(path: Path) -> None:
    """Wait until a file, or the list of names in a folder, is on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name a file in the errors of the system; an error of a write does not say where it was."""
    try:
        yield
    except OSError as error:
        error.filename, error.filename2 = str(path), None
        raise


@contextmanager
def writing(path: Path | str, what: str = "output") -> Iterator[None]:
    """Say what cannot be written, where and why, if the system refuses something in the block.

    Raises:
        InvalidInput: It does (`unwritable`).
    """
    try:
        yield
    except OSError as error:
        raise unwritable(path, error, what) from error


def unwritable(path: Path | str, error: OSError, what: str = "output") -> InvalidInput:
    """The fault that says what cannot be written, where and why; `DiskFull` where there is no room.

    Examples:
        >>> unwritable("s.zarr", PermissionError(13, "Permission denied"))
        InvalidInput('output must be writable; s.zarr is not: Permission denied')
    """
    words = f"{what} must be writable; {path} is not: {reason(error)}"
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return DiskFull(f"{words}; the disk that holds it is full: free some of it, or write to another")
    return InvalidInput(words)
