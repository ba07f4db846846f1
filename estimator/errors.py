"""The exceptions a caller of coilcal may see; any other is a bug."""

from __future__ import annotations


class CoilcalError(Exception):
    """A fault that one sentence explains: thing, rule, value and where it was found."""


class InvalidInput(CoilcalError, ValueError):
    """The caller's data or settings break a rule; the message names thing, rule, value and file.

    Examples:
        >>> raise InvalidInput("coil1.radius_m must be > 0; received -0.05 (configs/rig_a.yaml)")
        Traceback (most recent call last):
        ...
        estimator.errors.InvalidInput: coil1.radius_m must be > 0; received -0.05 (configs/rig_a.yaml)
    """


class CorruptStore(CoilcalError):
    """A file on disk is truncated, altered or of another schema version."""


def reason(error: Exception) -> str:
    """Cause of an error in words; for a file, without the path, which the message names already.

    Examples:
        >>> reason(FileNotFoundError(2, "No such file or directory", "rig.yaml"))
        'No such file or directory'
    """
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
