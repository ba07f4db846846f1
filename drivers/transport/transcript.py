r"""Writes and replays transcripts: text files of a conversation with an instrument, one line for each chunk of bytes.

A line reads `seconds > b'sent'` or `seconds < b'received'`, with bytes in Python's notation; `#` begins a comment.
"""

from __future__ import annotations

import ast
import errno
import logging
import os
import re
import stat
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from drivers.deadline import Deadline
from drivers.errors import DeviceFault
from drivers.transport.port import Port

_LOG = logging.getLogger(__name__)

_MOST_BYTES = 200_000_000
_LINE = re.compile(r"(?P<time_s>\d+\.\d+) (?P<direction>[<>]) (?P<data>b['\"].*)")


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that went one way.

    Attributes:
        time_s: Time since the recording began.
        direction: `>` to the instrument, `<` from it.
        data: The bytes.
    """

    time_s: float
    direction: Literal["<", ">"]
    data: bytes


def encode(chunk: Chunk) -> str:
    r"""One line of a transcript.

    Examples:
        >>> encode(Chunk(0.25, ">", b"*IDN?\n"))
        "0.250000 > b'*IDN?\\n'"
    """
    return f"{chunk.time_s:.6f} {chunk.direction} {chunk.data!r}"


def decode(text: str, name: str) -> list[Chunk]:
    r"""The chunks of a transcript.

    Args:
        text: The whole transcript.
        name: Name of the transcript in messages.

    Raises:
        DeviceFault: A line has another format.

    Examples:
        >>> decode("# F71\n0.250000 > b'*IDN?\\n'", "f71.txt")
        [Chunk(time_s=0.25, direction='>', data=b'*IDN?\n')]
    """
    chunks = []
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        match = _LINE.fullmatch(line.strip())
        try:
            data = ast.literal_eval(match["data"]) if match else None
        except (SyntaxError, ValueError):
            data = None
        if match is None or not isinstance(data, bytes):
            raise DeviceFault(
                f"a transcript must hold lines such as 0.250000 > b'*IDN?\\n'; received {line!r} ({name}, line {number})"
            )
        chunks.append(Chunk(float(match["time_s"]), "<" if match["direction"] == "<" else ">", data))
    return chunks


def _text_of(path: Path) -> str:
    """The text of a regular file of a limited size; on a pipe, opening would wait for ever.

    Raises:
        OSError: It is something else, larger, or cannot be read.
    """
    # The estimator's own opener is out of reach: drivers run without it.
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "it is no regular file")
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        content = file.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise OSError(errno.EFBIG, f"it holds more than {_MOST_BYTES} bytes")
    return content.decode()


class ReplayedPort:
    """Plays the instrument's part of a transcript, with the recorded timing; the driver must send what it sent then.

    It answers only the recorded questions in their order, such as those of `coilcal devices check`, and falls silent at the end. It does
    not serve another measurement, with other stops or another number of readings at each.
    """

    def __init__(self, chunks: list[Chunk], name: str) -> None:
        self.name = name
        self.arrived_s = time.monotonic()
        self._remaining = deque(chunks)
        self._arrived: deque[bytes] = deque()
        # The same moment on the host's clock and on the clock of the recording; renewed with each command.
        self._set_s, self._set_recorded_s = time.monotonic(), chunks[0].time_s if chunks else 0.0

    @classmethod
    def from_file(cls, path: Path) -> ReplayedPort:
        """Open a transcript on disk.

        Raises:
            DeviceFault: The file cannot be read.
        """
        try:
            return cls(decode(_text_of(path), str(path)), str(path))
        except (OSError, UnicodeDecodeError) as error:
            raise DeviceFault(f"{path} must be readable as a transcript; {error}") from error

    @property
    def is_over(self) -> bool:
        """Whether the driver has sent everything that was recorded."""
        return not any(chunk.direction == ">" for chunk in self._remaining)

    def send(self, data: bytes, deadline: Deadline) -> None:
        """See `Port.send`; raises DeviceFault if the recorded driver sent something else."""
        while self._remaining and self._remaining[0].direction == "<":
            self._arrived.append(self._remaining.popleft().data)
        expected = self._remaining.popleft() if self._remaining else None
        if expected is None or data != expected.data:
            rule = "nothing more: the recording ends here" if expected is None else f"{expected.data!r} next"
            raise DeviceFault(f"{self.name} must be sent {rule}; received {data!r}")
        self._set_s, self._set_recorded_s = time.monotonic(), expected.time_s

    def receive(self, deadline: Deadline) -> bytes:
        """See `Port.receive`."""
        while not self._arrived:
            if not any(chunk.direction == "<" for chunk in self._remaining):
                raise deadline.exceeded(f"{self.name} must receive", "the recording ends here")
            if self._remaining[0].direction == ">":
                raise deadline.exceeded(f"{self.name} must receive", "nothing is recorded here")
            wait_s = self._remaining[0].time_s - self._set_recorded_s - (time.monotonic() - self._set_s)
            if wait_s <= 0:
                self._arrived.append(self._remaining.popleft().data)
            elif deadline.is_over:
                raise deadline.exceeded(f"{self.name} must receive", "what comes next was recorded later")
            else:
                time.sleep(min(wait_s, deadline.remaining_s))
        self.arrived_s = time.monotonic()
        return self._arrived.popleft()

    def close(self) -> None:
        """See `Port.close`."""


class TranscriptFile:
    """A transcript being written. Each call reaches the file at once, so a crash loses at most the last one.

    If the disk is full, the transcript ends but the instrument goes on: a supply must still be switched off.
    """

    def __init__(self, path: Path, name: str) -> None:
        """Begin a transcript; an existing file is appended to.

        Args:
            path: File to write.
            name: Name of the recorded device in messages.
        """
        self._name = name
        self._file: int | None = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
        self._start_s = time.monotonic()
        self._lock = threading.Lock()

    @property
    def now_s(self) -> float:
        """Time since the transcript began."""
        return time.monotonic() - self._start_s

    def write(self, *chunks: Chunk) -> None:
        """Append chunks, with no chunk of another thread between them."""
        with self._lock:
            if self._file is None:
                return
            try:
                os.write(self._file, "".join(f"{encode(chunk)}\n" for chunk in chunks).encode("ascii"))
            except OSError as error:
                _LOG.error("the recording of %s ends here: %s", self._name, error)
                self._end()

    def close(self) -> None:
        """End the transcript; a second call does nothing."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None


class RecordingPort:
    """Records what passes through a port; one thread may send while another receives (`PumpedPort`)."""

    def __init__(self, port: Port, path: Path) -> None:
        """Record to a file; an existing file is appended to."""
        self.name = port.name
        self.arrived_s = port.arrived_s
        self._port, self._file = port, TranscriptFile(path, port.name)

    def send(self, data: bytes, deadline: Deadline) -> None:
        """See `Port.send`."""
        self._file.write(Chunk(self._file.now_s, ">", data))
        self._port.send(data, deadline)

    def receive(self, deadline: Deadline) -> bytes:
        """See `Port.receive`."""
        data = self._port.receive(deadline)
        self.arrived_s = self._port.arrived_s
        self._file.write(Chunk(self._file.now_s, "<", data))
        return data

    def close(self) -> None:
        """See `Port.close`."""
        self._port.close()
        self._file.close()
