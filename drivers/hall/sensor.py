"""Base of the Hall sensors: two ways to read a field from an instrument that is set up."""

from __future__ import annotations

from abc import abstractmethod

from drivers.deadline import Deadline
from drivers.on_channel import OnChannel
from drivers.protocols import Reading, Vector


class HallSensor(OnChannel):
    """A `FieldSensor`; each model defines how it is set up and read."""

    def read_field_T(self, *, timeout_s: float) -> Reading[Vector]:
        """See `FieldSensor.read_field_T`."""
        with self._ready(timeout_s) as deadline:
            return self._read_fresh(deadline)

    def read_new_T(self, *, timeout_s: float) -> list[Reading[Vector]]:
        """See `FieldSensor.read_new_T`."""
        with self._ready(timeout_s) as deadline:
            return self._read_new(deadline)

    @abstractmethod
    def _read_fresh(self, deadline: Deadline) -> Reading[Vector]:
        """A field measured after the call began."""

    @abstractmethod
    def _read_new(self, deadline: Deadline) -> list[Reading[Vector]]:
        """All measurements since the last reading, at least one."""
