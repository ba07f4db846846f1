"""Exchanges questions and answers over a port: one at a time, each with a deadline, and back in step after a fault."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault, DriverError
from drivers.transport.port import Port

_QUIET_S = 0.1
"""Silence after which a late answer is taken to be complete: no instrument here pauses that long inside an answer."""

_BUSY_S = 0.2
"""How long a command that must be sent in any case waits for a call of another thread."""

_LONGEST_ANSWER = 1_000_000


@dataclass(frozen=True, slots=True)
class Landmark:
    """A question with an unmistakable answer. Instruments answer in order, so everything before that answer is old.

    Attributes:
        question: Bytes to send.
        terminator: End of the answer.
        pattern: Matches the whole answer, and no answer to any other question.
    """

    question: bytes
    terminator: bytes
    pattern: re.Pattern[bytes]

    def find(self, channel: Channel, deadline: Deadline) -> None:
        """Ask, and discard everything before the answer; call inside `Channel.exchange`."""
        channel.send(self.question, deadline)
        while not self.pattern.fullmatch(channel.read_until(self.terminator, deadline)):
            pass


class Channel:
    """The only user of a port.

    After an error, the instrument may still answer the last question, or only begin to. The next exchange therefore waits for
    silence first and asks the landmark, so that no answer is taken for the answer to another question.

    Attributes:
        name: Name of the port.
        n_faults: Errors so far. After one, an instrument may have been switched off and on, so it must be set up again.
    """

    def __init__(
        self, port: Port, quieten: bytes = b"", find_step: Callable[[Channel, Deadline], None] | None = None
    ) -> None:
        """Own a port.

        Args:
            port: Port to own; nothing else may use it.
            quieten: Command that ends a stream; sent before waiting for silence.
            find_step: Called after that silence, such as `Landmark.find`; None if answers cannot be confused.
        """
        self._find_step = find_step
        self.name = port.name
        self._quieten = quieten
        self.n_faults = 0
        self._port = port
        self._arrived = bytearray()
        self._lock = threading.RLock()
        self._is_in_step = True
        self._is_closed = False

    @property
    def arrived_s(self) -> float:
        """Arrival of the bytes read last, on the clock of `time.monotonic()`."""
        return self._port.arrived_s

    @contextmanager
    def exchange(self, deadline: Deadline) -> Iterator[None]:
        """Hold the port exclusively; errors inside get the port's name and put the channel out of step.

        Raises:
            DeadlineExceeded: Another thread held the port, or the instrument did not fall silent.
            DeviceFault: The channel is closed.
        """
        if not self._lock.acquire(timeout=deadline.remaining_s):
            raise deadline.exceeded(f"{self.name} must be free", "a call of another thread goes on")
        try:
            if self._is_closed:
                raise DeviceFault("the connection must be open; it was closed")
            if not self._is_in_step:
                if self._quieten:
                    self.send(self._quieten, deadline)
                self.read_until_silent(_QUIET_S, deadline)
                if self._find_step is not None:
                    self._find_step(self, deadline)
                self._is_in_step = True
            yield
        except DriverError as error:
            self._note_fault()
            if self.name in str(error):
                raise
            raise type(error)(f"{error} ({self.name})") from error
        except BaseException:
            self._note_fault()
            raise
        finally:
            self._lock.release()

    def send(self, data: bytes, deadline: Deadline) -> None:
        """Send all bytes; call inside `exchange`."""
        self._port.send(data, deadline)

    def send_unasked(self, data: bytes, deadline: Deadline) -> None:
        """Send, and read neither before nor after; call outside `exchange`. The channel is out of step then.

        A call of another thread is waited for briefly only: it may be waiting for an instrument that does not answer.

        Raises:
            DeadlineExceeded: The port did not take all bytes in time.
            DeviceFault: The connection is lost, or the channel is closed.
        """
        has_lock = self._lock.acquire(timeout=deadline.at_most(_BUSY_S).remaining_s)
        try:
            if self._is_closed:
                raise DeviceFault(f"the connection must be open; it was closed ({self.name})")
            self._note_fault()
            self._port.send(data, deadline)
        finally:
            if has_lock:
                self._lock.release()

    def query(self, question: bytes, terminator: bytes, deadline: Deadline) -> bytes:
        """Ask, and return the answer without its terminator; call inside `exchange`. Bytes that came before are discarded."""
        self.take_arrived(deadline)
        self.send(question, deadline)
        return self.read_until(terminator, deadline)

    def read_until(self, terminator: bytes, deadline: Deadline) -> bytes:
        """Bytes up to the terminator, which is consumed but not returned; call inside `exchange`."""
        searched = 0
        while (end := self._arrived.find(terminator, searched)) < 0:
            searched = max(0, len(self._arrived) - len(terminator) + 1)
            if len(self._arrived) > _LONGEST_ANSWER:
                raise DeviceFault(
                    f"an answer must end with {terminator!r}; {len(self._arrived)} bytes came without it"
                )
            self._receive(f"an answer must end with {terminator!r}", deadline)
        answer = bytes(self._arrived[:end])
        del self._arrived[: end + len(terminator)]
        return answer

    def read_exactly(self, n_bytes: int, deadline: Deadline) -> bytes:
        """Exactly `n_bytes`; call inside `exchange`."""
        while len(self._arrived) < n_bytes:
            self._receive(f"an answer must have {n_bytes} bytes", deadline)
        answer = bytes(self._arrived[:n_bytes])
        del self._arrived[:n_bytes]
        return answer

    def read_some(self, deadline: Deadline) -> bytes:
        """All bytes that have arrived, at least one; call inside `exchange`."""
        if not self._arrived:
            self._receive("the stream must go on", deadline)
        return self._take()

    def has_arrived(self) -> bool:
        """Whether bytes can be read without waiting; call inside `exchange`."""
        if not self._arrived:
            try:
                self._arrived += self._port.receive(Deadline.after(0.0))
            except DeadlineExceeded:
                return False
        return True

    def read_until_silent(self, quiet_s: float, deadline: Deadline) -> bytes:
        """Bytes that arrive until `quiet_s` of silence; call inside `exchange`.

        Raises:
            DeadlineExceeded: The instrument does not fall silent.
        """
        while True:
            try:
                self._arrived += self._port.receive(deadline.at_most(quiet_s))
            except DeadlineExceeded:
                return self._take()
            if deadline.is_over:
                raise self._still_talking(deadline)

    def take_arrived(self, deadline: Deadline) -> bytes:
        """Bytes that have arrived, without waiting for more; call inside `exchange`.

        Raises:
            DeadlineExceeded: Bytes keep coming.
        """
        now = Deadline.after(0.0)
        while True:
            try:
                self._arrived += self._port.receive(now)
            except DeadlineExceeded:
                return self._take()
            if deadline.is_over:
                raise self._still_talking(deadline)

    def close(self) -> None:
        """Release the port without waiting for calls of other threads; a second call does nothing."""
        if not self._is_closed:
            self._is_closed = True
            self._port.close()

    def _note_fault(self) -> None:
        self._is_in_step = False
        self.n_faults += 1

    def _take(self) -> bytes:
        taken = bytes(self._arrived)
        self._arrived.clear()
        return taken

    def _still_talking(self, deadline: Deadline) -> DeadlineExceeded:
        last = bytes(self._arrived[-20:])
        self._arrived.clear()
        return deadline.exceeded("the device must fall silent", f"the last bytes are {last!r}")

    def _receive(self, rule: str, deadline: Deadline) -> None:
        try:
            self._arrived += self._port.receive(deadline)
        except DeadlineExceeded as error:
            arrived = f"received {bytes(self._arrived[-80:])!r}" if self._arrived else error.received
            raise deadline.exceeded(rule, arrived or "nothing received") from error
