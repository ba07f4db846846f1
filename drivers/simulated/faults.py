"""Faults of cables and instruments that a simulator shows on request."""

from __future__ import annotations

from enum import IntEnum

from drivers.children import SPAWN


class Fault(IntEnum):
    """Fault of an instrument."""

    NONE = 0
    MUTE = 1
    """It takes commands and sends nothing."""
    STALL = 2
    """It neither sends nor receives until the fault is cleared, then continues where it was."""
    DROP = 3
    """The connection breaks."""
    GARBAGE = 4
    """Meaningless bytes come before each answer."""
    PARTIAL = 5
    """Answers end in the middle."""
    SLOW = 6
    """Answers come in pieces, with pauses."""
    PROTECTIVE_STOP = 7
    """An arm hits an obstacle; it stays stopped until it is unlocked."""
    EMERGENCY_STOP = 8
    """Somebody presses the emergency stop of an arm."""


GARBAGE = bytes([0xFF, 0x00, 0x42, 0x0D, 0x0A, 0xFE])
"""Includes an end of line, and the first and last byte of a Senis packet."""


class FaultSwitch:
    """The fault of one simulator; another process may set it."""

    def __init__(self) -> None:
        self._value = SPAWN.Value("i", 0)

    @property
    def fault(self) -> Fault:
        """The present fault."""
        return Fault(self._value.value)

    @fault.setter
    def fault(self, fault: Fault) -> None:
        self._value.value = int(fault)


def spoil(data: bytes, fault: Fault) -> list[bytes]:
    """The pieces of an answer that are sent under a fault.

    Examples:
        >>> spoil(b"1.500", Fault.PARTIAL), spoil(b"1.500", Fault.MUTE), spoil(b"1.5", Fault.SLOW)
        ([b'1.'], [], [b'1', b'.', b'5'])
    """
    if not data or fault is Fault.MUTE:
        return []
    if fault is Fault.GARBAGE:
        return [GARBAGE + data]
    if fault is Fault.PARTIAL:
        return [data[: len(data) // 2]] if len(data) > 1 else []
    if fault is Fault.SLOW:
        return [data[index : index + 1] for index in range(len(data))]
    return [data]
