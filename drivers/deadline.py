"""The moment until which a call may take; made once at its start and handed down to every read and write."""

from __future__ import annotations

import time
from dataclasses import dataclass

from drivers.errors import DeadlineExceeded


@dataclass(frozen=True, slots=True)
class Deadline:
    """A moment on the host's monotonic clock.

    Attributes:
        at_s: The moment, as `time.monotonic()` counts.
        allowed_s: Time that the caller allowed, for messages.

    Examples:
        >>> deadline = Deadline.after(60.0)
        >>> 59.0 < deadline.remaining_s <= 60.0, deadline.is_over
        (True, False)
    """

    at_s: float
    allowed_s: float

    @classmethod
    def after(cls, timeout_s: float) -> Deadline:
        """The moment `timeout_s` from now."""
        return cls(time.monotonic() + timeout_s, timeout_s)

    @property
    def remaining_s(self) -> float:
        """Time left; zero when it is over."""
        return max(0.0, self.at_s - time.monotonic())

    @property
    def is_over(self) -> bool:
        """Whether no time is left."""
        return time.monotonic() >= self.at_s

    def at_most(self, timeout_s: float) -> Deadline:
        """This moment, or `timeout_s` from now where that is earlier."""
        return Deadline(min(self.at_s, time.monotonic() + timeout_s), self.allowed_s)

    def exceeded(self, rule: str, received: str) -> DeadlineExceeded:
        """The error to raise when it is over, as in `exceeded("supply must answer", "nothing received")`."""
        error = DeadlineExceeded(f"{rule} within {self.allowed_s:g} s; {received}")
        error.received = received
        return error

    def sleep(self, duration_s: float, rule: str) -> None:
        """Wait; where that takes longer than what is left, wait that long and raise.

        Raises:
            DeadlineExceeded: The time is over.
        """
        time.sleep(min(duration_s, self.remaining_s))
        if self.is_over:
            raise self.exceeded(rule, "waited for as long")

    def sleep_out(self) -> None:
        """Wait until the moment has come."""
        time.sleep(self.remaining_s)
