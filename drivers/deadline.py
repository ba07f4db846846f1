"""The moment by which a call must end; made once at its start and handed down to every read and write."""

from __future__ import annotations

import time
from dataclasses import dataclass

from drivers.errors import DeadlineExceeded


@dataclass(frozen=True, slots=True)
class Deadline:
    """A moment on the host's monotonic clock.

    Attributes:
        at_s: The moment, on the clock of `time.monotonic()`.
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
        """Time left; zero once the deadline has passed."""
        return max(0.0, self.at_s - time.monotonic())

    @property
    def is_over(self) -> bool:
        """Whether the deadline has passed."""
        return time.monotonic() >= self.at_s

    def at_most(self, timeout_s: float) -> Deadline:
        """This deadline, or `timeout_s` from now if that is earlier."""
        return Deadline(min(self.at_s, time.monotonic() + timeout_s), self.allowed_s)

    def exceeded(self, rule: str, received: str) -> DeadlineExceeded:
        """The error to raise once the deadline has passed, as in `exceeded("supply must answer", "nothing received")`."""
        error = DeadlineExceeded(f"{rule} within {self.allowed_s:.3g} s; {received}")
        error.received = received
        return error

    def sleep(self, duration_s: float, rule: str) -> None:
        """Wait for `duration_s`, but not beyond the deadline.

        Raises:
            DeadlineExceeded: The deadline passed first.
        """
        time.sleep(min(duration_s, self.remaining_s))
        if self.is_over:
            raise self.exceeded(rule, "waited for as long")

    def sleep_out(self) -> None:
        """Wait until the deadline."""
        time.sleep(self.remaining_s)
