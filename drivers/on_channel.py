"""Base of instruments behind a channel: identify, close, and settings that are made once and again after a fault."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.deadline import Deadline
from drivers.device import ClosesItself
from drivers.readings import ReadingCounter
from drivers.transport.channel import Channel, Landmark
from drivers.transport.port import Port

_NEVER = -1

_IDENTITY = re.compile(rb'[^"]*[A-Za-z]{3}[^",]*,[^"]*')
"""An identity has a word, as no measured value has, and no error state after it."""


def identity_landmark(end: bytes, answer_end: bytes) -> Landmark:
    r"""The landmark `*IDN?`, which most instruments know.

    Args:
        end: Terminator of lines sent.
        answer_end: Terminator of lines received.

    Examples:
        >>> pattern = identity_landmark(b"\n", b"\r\n").pattern
        >>> bool(pattern.fullmatch(b"LSCI,MODEL460,0,022499")), bool(pattern.fullmatch(b"+12.50,-0.25, OL ,+00.00"))
        (True, False)
    """
    return Landmark(b"*IDN?" + end, answer_end, _IDENTITY)


class OnChannel(ClosesItself):
    """An instrument that is set up before its first reading; nothing is sent before the first call.

    It is set up again after a fault, for it may have been switched off and on.
    """

    def __init__(self, port: Port, *, quieten: bytes = b"", landmark: Landmark | None = None) -> None:
        """Own a port.

        Args:
            port: Port to own; nothing else may use it.
            quieten: Command that ends a stream.
            landmark: Question that brings questions and answers back in step after a fault.
        """
        self._channel = Channel(port, quieten, landmark.find if landmark else None)
        self._counter = ReadingCounter()
        self._set_up_at_fault = _NEVER

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`."""
        deadline = Deadline.after(timeout_s)
        with self._channel.exchange(deadline):
            return self._identity(deadline)

    def close(self) -> None:
        """See `Device.close`."""
        self._channel.close()

    @abstractmethod
    def _identity(self, deadline: Deadline) -> str:
        """The instrument's own description."""

    def _set_up(self, deadline: Deadline) -> None:
        """Make all settings; does nothing unless overridden."""

    @contextmanager
    def _ready(self, timeout_s: float) -> Iterator[Deadline]:
        """Hold the instrument exclusively, and set it up if needed."""
        deadline = Deadline.after(timeout_s)
        with self._channel.exchange(deadline):
            if not self._is_set_up:
                self._set_up(deadline)
                self._set_up_at_fault = self._channel.n_faults
            yield deadline

    @property
    def _is_set_up(self) -> bool:
        return self._set_up_at_fault == self._channel.n_faults

    def _forget_set_up(self) -> None:
        self._set_up_at_fault = _NEVER
