"""Runs a current source in a child process, which ramps the current to zero and switches off when its parent is gone."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from drivers.device import ClosesItself
from drivers.errors import DriverError
from drivers.protocols import Reading
from drivers.supervised import LONGEST_START_S, Supervised, Unanswered
from drivers.supplies.ramped import RampedSource

_LOG = logging.getLogger(__name__)

_CLOSE_S = 2.0
"""Time to allow beyond switching off."""
_LAST_ATTEMPT_S = 3.0
"""Time that the last attempt to switch off a mute supply may take beyond the deadline."""


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
        self._replacing = threading.Lock()
        self._was_told = False
        self._is_closed = False

    @property
    def pid(self) -> int | None:
        """Process id of the child."""
        return self._supervised.pid

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`."""
        return str(self._supervised.call("identify", timeout_s=timeout_s))

    def require_alive(self) -> None:
        """See `Supervised.require_alive`."""
        self._supervised.require_alive()

    def set_current_A(self, current_A: float, *, timeout_s: float) -> None:
        """See `CurrentSource.set_current_A`."""
        self._was_told = True
        self._supervised.call("set_current_A", current_A=current_A, timeout_s=timeout_s)

    def read_current_A(self, *, timeout_s: float) -> Reading[float]:
        """See `CurrentSource.read_current_A`."""
        return self._supervised.call("read_current_A", timeout_s=timeout_s)

    def output_off(self, *, timeout_s: float) -> None:
        """See `CurrentSource.output_off`; ends a ramp of another thread. A child that is dead or hangs is replaced for this.

        The replacement gets `longest_start_s` and `longest_off_s`, whatever is left of `timeout_s`.
        """
        self._was_told = True
        supervised = self._supervised
        if not supervised.is_gone:
            try:
                self._switch_off(supervised, timeout_s)
                return
            except DriverError as error:
                if not (isinstance(error, Unanswered) or supervised.is_gone):
                    raise
        self._switch_off(self._replacement_of(supervised), self.longest_off_s)

    def close(self) -> None:
        """See `Device.close`; a child that is dead or hangs is replaced if the supply was ever told anything."""
        if self._is_closed:
            return
        self._is_closed = True
        supervised = self._supervised
        if not supervised.is_gone:
            try:
                self._close(supervised)
                return
            except DriverError as error:
                if not (isinstance(error, Unanswered) or supervised.is_gone):
                    raise
        if not self._was_told:
            supervised.kill()
            return
        replacement = self._replacement_of(supervised)
        try:
            self._switch_off(replacement, self.longest_off_s)
        finally:
            self._close(replacement)

    def _switch_off(self, supervised: Supervised, timeout_s: float) -> None:
        supervised.call("output_off", timeout_s=timeout_s, is_urgent=True, grace_s=_LAST_ATTEMPT_S)

    def _close(self, supervised: Supervised) -> None:
        """Switch off if the supply was ever told anything, and end the child; it goes on switching off where that is not confirmed."""
        supervised.close(timeout_s=self.longest_off_s + _CLOSE_S + _LAST_ATTEMPT_S)

    def _replacement_of(self, supervised: Supervised) -> Supervised:
        """Another child in place of one that is dead or hangs, which is killed first: it owns the port."""
        with self._replacing:
            if self._supervised is supervised:
                _LOG.warning("the process of %s is dead or hangs; a new one brings it to rest", self._name)
                supervised.kill()
                self._supervised = self._start()
            return self._supervised

    def _start(self) -> Supervised:
        return Supervised(
            self._make,
            self._name,
            longest_start_s=self._longest_start_s,
            longest_rest_s=self.longest_off_s + _CLOSE_S + _LAST_ATTEMPT_S,
        )
