"""Runs a current source in a child process, which ramps the current to zero and switches off when its parent is gone."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from drivers.device import ClosesItself
from drivers.protocols import Reading
from drivers.supervised import LONGEST_START_S, Supervised
from drivers.supplies.ramped import RampedSource

_LOG = logging.getLogger(__name__)

_CLOSE_S = 2.0
"""Time to allow beyond switching off."""


class SupervisedSource(ClosesItself):
    """A `CurrentSource`, with the supply's port owned by a child process."""

    def __init__(
        self,
        make: Callable[[threading.Event], RampedSource],
        name: str,
        *,
        slew_A_per_s: float,
        longest_off_s: float,
        longest_start_s: float = LONGEST_START_S,
    ) -> None:
        """Start the child, which opens the port.

        Args:
            make: Makes the source in the child; the event ends a ramp.
            name: Name of the source in messages.
            slew_A_per_s: As of the source that is made.
            longest_off_s: As of the source that is made.
            longest_start_s: Time for starting the child and opening the port.
        """
        self.slew_A_per_s, self.longest_off_s = slew_A_per_s, longest_off_s
        self._make, self._name, self._longest_start_s = make, name, longest_start_s
        self._supervised = self._start()
        self._is_closed = False

    @property
    def pid(self) -> int | None:
        """Process id of the child."""
        return self._supervised.pid

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`."""
        return str(self._supervised.call("identify", timeout_s=timeout_s))

    def set_current_A(self, current_A: float, *, timeout_s: float) -> None:
        """See `CurrentSource.set_current_A`."""
        self._supervised.call("set_current_A", current_A=current_A, timeout_s=timeout_s)

    def read_current_A(self, *, timeout_s: float) -> Reading[float]:
        """See `CurrentSource.read_current_A`."""
        reading: Reading[float] = self._supervised.call("read_current_A", timeout_s=timeout_s)
        return reading

    def output_off(self, *, timeout_s: float) -> None:
        """See `CurrentSource.output_off`; ends a ramp of another thread. A dead child is replaced for this."""
        if self._supervised.has_ended:
            _LOG.warning("%s lost its process; a new one brings it to rest", self._name)
            self._supervised = self._start()
        self._supervised.call("output_off", timeout_s=timeout_s, is_urgent=True)

    def close(self) -> None:
        """See `Device.close`."""
        if not self._is_closed:
            self._is_closed = True
            if self._supervised.has_ended:
                self.output_off(timeout_s=self.longest_off_s)
            self._supervised.close(timeout_s=self.longest_off_s + _CLOSE_S)

    def _start(self) -> Supervised:
        return Supervised(self._make, self._name, longest_start_s=self._longest_start_s)
