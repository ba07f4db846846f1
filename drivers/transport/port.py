"""What all ports have in common: bytes out, bytes in, and how a lost connection reads."""

from __future__ import annotations

from typing import Protocol

from drivers.deadline import Deadline


class Port(Protocol):
    """An open connection; it keeps nothing back, and one channel owns it.

    Attributes:
        name: What the operator knows it by, such as `/dev/ttyUSB0` or `192.168.0.12:7777`.
        arrived_s: When the bytes handed out last arrived, as `time.monotonic()` counts.
    """

    name: str
    arrived_s: float

    def send(self, data: bytes, deadline: Deadline) -> None:
        """Hand over all bytes.

        Raises:
            DeadlineExceeded: The port did not take them in time; some may be on their way.
            DeviceFault: The connection is lost.
        """
        ...

    def receive(self, deadline: Deadline) -> bytes:
        """What has arrived, at least one byte; waits for it until the deadline.

        Raises:
            DeadlineExceeded: Nothing arrived.
            DeviceFault: The connection is lost.
        """
        ...

    def close(self) -> None:
        """Release the connection; a second call does nothing."""
        ...
