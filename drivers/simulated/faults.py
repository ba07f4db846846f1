"""Faults that a simulator shows on request, as cables and instruments do."""

from __future__ import annotations

from enum import IntEnum

from drivers.simulated.world import SPAWN


class Fault(IntEnum):
    """What is wrong with an instrument."""

    NONE = 0
    MUTE = 1
    """It takes commands and says nothing."""
    STALL = 2
    """It says and hears nothing until the fault is taken away, then goes on where it was."""
    DROP = 3
    """The connection breaks."""
    GARBAGE = 4
    """Bytes that no instrument sends come before each answer."""
    PARTIAL = 5
    """Answers end in the middle."""
    SLOW = 6
    """Answers come in pieces with pauses."""
    PROTECTIVE_STOP = 7
    """An arm meets an obstacle; it stays stopped until that is unlocked."""
    EMERGENCY_STOP = 8
    """Somebody presses the button of an arm."""


GARBAGE = bytes([0xFF, 0x00, 0x42, 0x0D, 0x0A, 0xFE])
"""Holds an end of line and the first and last byte of a Senis packet."""


class FaultSwitch:
    """The fault of one simulator, set by another process."""

    def __init__(self) -> None:
        self._value = SPAWN.Value("i", 0)

    @property
    def fault(self) -> Fault:
        """What is wrong now."""
        return Fault(self._value.value)

    @fault.setter
    def fault(self, fault: Fault) -> None:
        self._value.value = int(fault)


def spoil(data: bytes, fault: Fault) -> list[bytes]:
    """What becomes of an answer: the pieces that are sent.

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
        return [data[place : place + 1] for place in range(len(data))]
    return [data]
