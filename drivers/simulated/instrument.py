"""Protocol of a simulated instrument: bytes in, bytes out; `drivers.simulated.process` serves it."""

from __future__ import annotations

from typing import Protocol


class Instrument(Protocol):
    """An instrument's side of the protocol."""

    def take(self, data: bytes) -> bytes:
        """Answer to bytes that arrived; they may be part of a command, or several."""
        ...

    def stream(self) -> bytes:
        """Bytes that it has sent unasked since the last call."""
        ...
