r"""A recorded conversation with an instrument: a text file with one line for each chunk of bytes.

A line reads `seconds > b'sent'` or `seconds < b'received'`, bytes as Python writes them; `#` begins a comment.
"""

from __future__ import annotations

import ast
import logging
import os
import re
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

_LINE = re.compile(r"(?P<time_s>\d+\.\d+) (?P<direction>[<>]) (?P<data>b['\"].*)")


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes that went one way.

    Attributes:
        time_s: Since the recording began.
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


def decode(text: str, place: str) -> list[Chunk]:
    r"""The chunks of a transcript.

    Args:
        text: The whole transcript.
        place: What to call it in messages.

    Raises:
        DeviceFault: A line is none of a transcript.

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
                f"a transcript must hold lines such as 0.250000 > b'*IDN?\\n'; received {line!r} ({place}, line {number})"
            )
        chunks.append(Chunk(float(match["time_s"]), "<" if match["direction"] == "<" else ">", data))
    return chunks


class ReplayedPort:
    """Plays the instrument's part of a transcript, at the pace of then; the driver must say what it said when it was recorded.

    What it is not: an instrument. It answers the questions that were recorded in their order, such as those of `coilcal devices check`,
    and falls silent at its end; a measurement with other stops, or as many readings at each as it takes, is none of those.
    """

    def __init__(self, chunks: list[Chunk], name: str) -> None:
        self.name = name
        self.arrived_s = time.monotonic()
        self._left = deque(chunks)
        self._arrived: deque[bytes] = deque()
        # A moment on the host's clock and on that of the recording; the clocks are set with each command.
        self._set_s, self._set_recorded_s = time.monotonic(), chunks[0].time_s if chunks else 0.0

    @classmethod
    def from_file(cls, path: Path) -> ReplayedPort:
        """A transcript on disk.

        Raises:
            DeviceFault: It cannot be read.
        """
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise DeviceFault(f"{path} must be readable as a transcript; {error}") from error
        return cls(decode(text, str(path)), str(path))

    @property
    def is_over(self) -> bool:
        """Whether the driver has said everything that was recorded."""
        return not any(chunk.direction == ">" for chunk in self._left)

    def send(self, data: bytes, deadline: Deadline) -> None:
        """See `Port.send`; raises DeviceFault where the recorded driver said something else."""
        while self._left and self._left[0].direction == "<":
            self._arrived.append(self._left.popleft().data)
        expected = self._left.popleft() if self._left else None
        if expected is None or data != expected.data:
            wanted = (
                "nothing more: the recording ends here" if expected is None else f"{expected.data!r} next"
            )
            raise DeviceFault(f"{self.name} must be sent {wanted}; received {data!r}")
        self._set_s, self._set_recorded_s = time.monotonic(), expected.time_s

    def receive(self, deadline: Deadline) -> bytes:
        """See `Port.receive`."""
        while not self._arrived:
            if not any(chunk.direction == "<" for chunk in self._left):
                raise deadline.exceeded(f"{self.name} must receive", "the recording ends here")
            if self._left[0].direction == ">":
                raise deadline.exceeded(f"{self.name} must receive", "nothing is recorded here")
            wait_s = self._left[0].time_s - self._set_recorded_s - (time.monotonic() - self._set_s)
            if wait_s <= 0:
                self._arrived.append(self._left.popleft().data)
            elif deadline.is_over:
                raise deadline.exceeded(f"{self.name} must receive", "what comes next was recorded later")
            else:
                time.sleep(min(wait_s, deadline.remaining_s))
        self.arrived_s = time.monotonic()
        return self._arrived.popleft()

    def close(self) -> None:
        """See `Port.close`."""


class TranscriptFile:
    """A transcript that is being written, each call at once, so that a crash leaves all but the last.

    Where the disk is full the transcript ends and the instrument goes on: a supply must be switched off all the same.
    """

    def __init__(self, path: Path, name: str) -> None:
        """Begin it; what the file held is kept.

        Args:
            path: Of the file.
            name: Of what is recorded, for messages.
        """
        self._name = name
        self._file: int | None = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o644)
        self._start_s = time.monotonic()
        self._lock = threading.Lock()

    @property
    def now_s(self) -> float:
        """Time since it began."""
        return time.monotonic() - self._start_s

    def write(self, *chunks: Chunk) -> None:
        """Add chunks, with nothing of another thread between them."""
        with self._lock:
            if self._file is None:
                return
            try:
                os.write(self._file, "".join(f"{encode(chunk)}\n" for chunk in chunks).encode("ascii"))
            except OSError as error:
                _LOG.error("the recording of %s ends here: %s", self._name, error)
                self._end()

    def close(self) -> None:
        """End it; a second call does nothing."""
        with self._lock:
            self._end()

    def _end(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None


class RecordingPort:
    """Writes down what passes through a port; one thread may send while another receives (`PumpedPort`)."""

    def __init__(self, port: Port, path: Path) -> None:
        """Record to a file; what it held is kept."""
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
