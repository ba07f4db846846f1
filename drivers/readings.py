"""Numbers the readings of one device, flags losses, and decodes numbers as instruments write them."""

from __future__ import annotations

import math
import time
from typing import TypeVar

from drivers.errors import DeviceFault
from drivers.protocols import Reading, ReadingFlag, Vector

Value = TypeVar("Value")

ICE_POINT_K = 273.15
"""0 degrees Celsius."""

_SCPI_NO_NUMBER = 9e37
"""SCPI-99 section 7.2.1.5 writes infinity as 9.9e37 and not-a-number as 9.91e37."""

_LONGEST_QUOTE = 80
"""Bytes of an answer that a message shows; the buffer of a Hall sensor may fill many screens."""


class ReadingCounter:
    """Counts readings for `Reading.sequence`, and marks the first one after a loss.

    Examples:
        >>> counter = ReadingCounter()
        >>> counter.note_loss()
        >>> counter.reading(1.0).flags, counter.reading(2.0).flags, counter.reading(3.0).sequence
        (<ReadingFlag.DROPPED: 4>, <ReadingFlag.NONE: 0>, 2)
    """

    def __init__(self) -> None:
        self._n_readings = 0
        self._has_lost = False

    def note_loss(self) -> None:
        """Mark the next reading as `DROPPED`."""
        self._has_lost = True

    def reading(
        self,
        value: Value,
        flags: ReadingFlag = ReadingFlag.NONE,
        *,
        host_monotonic_s: float | None = None,
        device_time_s: float | None = None,
    ) -> Reading[Value]:
        """The next reading; its time of arrival is now unless given."""
        if self._has_lost:
            flags |= ReadingFlag.DROPPED
        arrived_s = time.monotonic() if host_monotonic_s is None else host_monotonic_s
        reading = Reading(self._n_readings, arrived_s, device_time_s, value, flags)
        self._n_readings += 1
        self._has_lost = False
        return reading


def number(text: str, what: str) -> float:
    """A number as instruments write it; SCPI's infinity and not-a-number become NaN.

    Raises:
        DeviceFault: The text is not a number.

    Examples:
        >>> number("+1.5E-3", "a current"), number("9.91E37", "a field")
        (0.0015, nan)
    """
    try:
        value = float(text)
    except ValueError as error:
        raise DeviceFault(f"{what} must be a number; received {quoted(text)}") from error
    return math.nan if abs(value) >= _SCPI_NO_NUMBER else value


def quoted(answer: bytes | str) -> str:
    """An answer as messages show it: its beginning, and how long it is if that is not all.

    Examples:
        >>> quoted(b"1.5 A"), quoted("0.125," * 5000)
        ("b'1.5 A'", "'0.125,0.125,0.125,0.125,0.125,0.125,0.125,0.125,0.125,0.125,0.125,0.125,0.125,0.' (the first 80 of 30000 bytes)")
    """
    if len(answer) <= _LONGEST_QUOTE:
        return repr(answer)
    return f"{answer[:_LONGEST_QUOTE]!r} (the first {_LONGEST_QUOTE} of {len(answer)} bytes)"


def ascii_text(data: bytes) -> str:
    """Decode an answer as ASCII.

    Raises:
        DeviceFault: It holds other bytes.
    """
    try:
        return data.decode("ascii")
    except UnicodeDecodeError as error:
        raise DeviceFault(f"an answer must be ASCII; received {quoted(data)}") from error


def over_range(field_T: Vector) -> ReadingFlag:
    """`OVER_RANGE` if a component is NaN."""
    return ReadingFlag.OVER_RANGE if any(math.isnan(value) for value in field_T) else ReadingFlag.NONE
