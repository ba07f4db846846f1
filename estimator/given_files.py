"""The only opener of files that a user names, or that may have come from elsewhere: regular files of a limited size, never waited for.

A named pipe blocks whoever opens it, a device may be endless or may act when it is opened, and a text of another encoding is no text. All
of them are refused in one sentence, and a file is never read beyond its limit.
"""

from __future__ import annotations

import codecs
import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from estimator.errors import CoilcalError, InvalidInput, reason

MOST_SETTINGS_BYTES = 4_000_000  # of a rig, a plan, settings or a truth
MOST_RESULT_BYTES = 200_000_000  # of a summary, a diagnosis or a log that coilcal wrote
MOST_TABLE_BYTES = 2_000_000_000  # of readings or of a field map: about ten million rows

KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def open_given(
    path: Path, most_bytes: int, fault: type[CoilcalError] = InvalidInput, rule: str = "must be readable"
) -> BinaryIO:
    """Open a regular file for reading.

    Args:
        path: The file; a link to one is followed.
        most_bytes: Bytes that it may hold.
        fault: What is raised: `InvalidInput` for a file of the user, `CorruptStore` for one that coilcal wrote.
        rule: What the file must be, for messages.
    Raises:
        fault: It is missing or may not be read, is no regular file, or is larger. The sentence names the path.
    """
    try:
        _refuse_kind(path, path.stat().st_mode, fault, rule)  # not opened: that may already start something
        # Where a pipe took its place meanwhile, the call does not wait for a writer.
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
        try:
            status = os.fstat(file.fileno())
            _refuse_kind(path, status.st_mode, fault, rule)
            if status.st_size > most_bytes:
                _refuse_size(path, most_bytes, fault)
        except BaseException:
            file.close()
            raise
    except OSError as error:
        raise fault(f"{path} {rule}: {reason(error)}") from error
    except ValueError as error:
        if isinstance(error, CoilcalError):
            raise
        raise fault(f"path must hold no NUL; received {str(path)[:80]!r}") from error
    return file


def read_given(
    path: Path, most_bytes: int, fault: type[CoilcalError] = InvalidInput, rule: str = "must be readable"
) -> bytes:
    """The bytes of a regular file; arguments and errors as for `open_given`, and a file that grows beyond the limit is refused."""
    with open_given(path, most_bytes, fault, rule) as file:
        try:
            content = file.read(most_bytes + 1)
        except OSError as error:
            raise fault(f"{path} {rule}: {reason(error)}") from error
    if len(content) > most_bytes:
        _refuse_size(path, most_bytes, fault)
    return content


def read_given_text(path: Path, most_bytes: int, fault: type[CoilcalError] = InvalidInput) -> str:
    """The text of a regular file in UTF-8, without a byte order mark.

    Args:
        path, most_bytes, fault: As for `open_given`.
    Raises:
        fault: As for `open_given`, or the text is in another encoding; the sentence names the line.
    """
    return text_of(read_given(path, most_bytes, fault, "must be readable as text"), path, fault)


def text_of(
    content: bytes, path: Path | str, fault: type[CoilcalError] = InvalidInput, first_line: int = 1
) -> str:
    r"""Bytes as text in UTF-8, without a byte order mark.

    Args:
        content: The bytes.
        path: Their origin, for messages.
        fault: What is raised.
        first_line: Number of the line with which they begin, for messages.
    Raises:
        fault: They are no UTF-8; the sentence names the line.
    Examples:
        >>> text_of(b"Bx [\xb5T]", "readings.csv")
        Traceback (most recent call last):
        ...
        estimator.errors.InvalidInput: readings.csv must be readable as text: 'utf-8' has no byte 0xb5, as in line 1; save it in UTF-8
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise fault(f"{path} must be readable as text: it is in UTF-16; save it in UTF-8")
    try:
        return content.removeprefix(codecs.BOM_UTF8).decode()
    except UnicodeDecodeError as error:
        line = first_line + error.object.count(b"\n", 0, error.start)
        byte = error.object[error.start]
        raise fault(
            f"{path} must be readable as text: 'utf-8' has no byte {byte:#04x}, as in line {line}; save it in UTF-8"
        ) from error


def _refuse_kind(path: Path, mode: int, fault: type[CoilcalError], rule: str) -> None:
    if stat.S_ISDIR(mode):
        raise fault(f"{path} {rule}: {os.strerror(errno.EISDIR)}")
    if not stat.S_ISREG(mode):
        kind = KINDS.get(stat.S_IFMT(mode), "something else")
        raise fault(f"{path} {rule}, as a regular file; it is {kind}")


def _refuse_size(path: Path, most_bytes: int, fault: type[CoilcalError]) -> None:
    raise fault(f"{path} must hold at most {most_bytes} bytes; it holds more")
