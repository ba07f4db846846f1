"""Errors of an instrument; each message names device, rule and value."""

from __future__ import annotations


class DriverError(Exception):
    """An instrument did not do what was asked; the subclasses say why."""


class DeadlineExceeded(DriverError, TimeoutError):
    """No answer within the time allowed; whether the device obeyed is unknown.

    Attributes:
        received: What came instead, in words; may be empty.

    Examples:
        >>> raise DeadlineExceeded("supply must answer within 0.5 s; nothing received (/dev/ttyUSB0)")
        Traceback (most recent call last):
        ...
        drivers.errors.DeadlineExceeded: supply must answer within 0.5 s; nothing received (/dev/ttyUSB0)
    """

    received: str = ""


class DeviceFault(DriverError):
    """The device reported a fault, refused the command, or is no longer there."""


class Refused(DriverError, ValueError):
    """The request is beyond a limit of the rig; nothing was sent and the device is unchanged.

    Examples:
        >>> raise Refused("supply.current_A must be within -5 and 5; received 7")
        Traceback (most recent call last):
        ...
        drivers.errors.Refused: supply.current_A must be within -5 and 5; received 7
    """


class BroughtToRest(Refused):
    """The rig was brought to rest before; it takes no command until it is opened anew."""
