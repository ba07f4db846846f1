"""Protocol of all ports: bytes out, bytes in, and the error of a lost connection."""

from __future__ import annotations

from typing import Protocol

from drivers.deadline import Deadline


class Port(Protocol):
    """An open connection without a send buffer; one channel owns it.

    Attributes:
        name: The operator's name for it, such as `/dev/ttyUSB0` or `192.168.0.12:7777`.
        arrived_s: Arrival of the bytes returned last, on the clock of `time.monotonic()`.
    """

    name: str
    arrived_s: float

    def send(self, data: bytes, deadline: Deadline) -> None:
        """Send all bytes.

        Raises:
            DeadlineExceeded: The port did not take them in time; some may be on their way.
            DeviceFault: The connection is lost.
        """
        ...

    def receive(self, deadline: Deadline) -> bytes:
        """Bytes that have arrived, at least one; waits for it until the deadline.

        Raises:
            DeadlineExceeded: Nothing arrived.
            DeviceFault: The connection is lost.
        """
        ...

    def close(self) -> None:
        """Release the connection; a second call does nothing."""
        ...
