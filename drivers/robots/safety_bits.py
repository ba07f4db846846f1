"""Turns the status bits of a Universal Robots controller into sentences for the operator (RTDE guide, table of output fields)."""

from __future__ import annotations

from drivers.robots.rtde import Value

_NORMAL = 1 << 0
_PLAYING = 2

NOT_RUNNING = "its program is not running"
"""The reason of `why_not_running` where no safety stop holds the arm."""

_STOPS = (
    (1 << 7, "its emergency stop is pressed: release the button and restart it at the pendant"),
    (1 << 6, "its emergency stop is pressed: release the button and restart it at the pendant"),
    (1 << 5, "an emergency stop of the system is pressed: release it and restart the arm at the pendant"),
    (1 << 9, "its safety system has a fault: see the pendant"),
    (1 << 8, "its safety system found a violation: see the pendant"),
    (1 << 2, "it is in protective stop: find out what it hit, then unlock it at the pendant"),
    (1 << 4, "a safeguard stop holds it: close the guard"),
    (1 << 3, "it is in recovery mode: move it back by hand"),
    (1 << 10, "its safety system has stopped it: see the pendant"),
)


def why_stopped(values: dict[str, Value]) -> str | None:
    """One sentence for the operator if a safety stop holds the arm, moving or not; None otherwise.

    Args:
        values: Variables of a sample, with `safety_status_bits`.

    Examples:
        >>> why_stopped({"safety_status_bits": 1}) is None
        True
        >>> why_stopped({"safety_status_bits": 4})
        'it is in protective stop: find out what it hit, then unlock it at the pendant'
    """
    bits = values["safety_status_bits"]
    if not isinstance(bits, int):
        return "it does not report its safety status"
    for bit, sentence in _STOPS:
        if bits & bit:
            return sentence
    if not bits & _NORMAL and not bits & 1 << 1:  # in reduced mode the arm is slow, but obeys
        return "its safety system is not in normal mode: see the pendant"
    return None


def why_not_running(values: dict[str, Value]) -> str | None:
    """One sentence for the operator if the arm does not obey; None if it does.

    Args:
        values: Variables of a sample, with `safety_status_bits` and `runtime_state`.

    Examples:
        >>> why_not_running({"safety_status_bits": 1, "runtime_state": 1})
        'its program is not running'
    """
    reason = why_stopped(values)
    return reason or (None if values["runtime_state"] == _PLAYING else NOT_RUNNING)
