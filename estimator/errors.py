"""The exceptions a caller of coilcal may see; any other is a bug. And how faults are collected, and put into words."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from difflib import get_close_matches

MOST_QUOTED = 60  # characters of a value from a file or a user, in a sentence
LEAST_LIKENESS = 0.6  # of a name to the one that may have been meant, from 0 to 1; difflib's own default


@dataclass(frozen=True)
class Place:
    """Location of a fault in a text file.

    Attributes:
        file: Its path.
        line: From 1.
        column: From 1: a character of a YAML file, a cell of a CSV file. None where the whole line is meant.
    """

    file: str
    line: int
    column: int | None = None

    def __str__(self) -> str:
        return f"{self.file}, line {self.line}"


class CoilcalError(Exception):
    """A fault that one sentence explains: thing, rule, value and where it was found."""


class InvalidInput(CoilcalError, ValueError):
    """The caller's data or settings break a rule; the message names thing, rule, value and file.

    Attributes:
        place: Location in a text file; None where there is none.
    Examples:
        >>> raise InvalidInput("coil1.radius_m must be > 0; received -0.05 (configs/rig_a.yaml)")
        Traceback (most recent call last):
        ...
        estimator.errors.InvalidInput: coil1.radius_m must be > 0; received -0.05 (configs/rig_a.yaml)
    """

    def __init__(self, message: str, place: Place | None = None) -> None:
        super().__init__(message)
        self.place = place

    @classmethod
    def at(cls, place: Place, words: str) -> InvalidInput:
        """A fault whose words end in its file and line.

        Examples:
            >>> print(InvalidInput.at(Place("rig.yaml", 3), "radius_mm must be > 0; received -5"))
            radius_mm must be > 0; received -5 (rig.yaml, line 3)
        """
        return cls(f"{words} ({place})", place)


class DiskFull(InvalidInput):
    """The disk is full. What was there before is unchanged."""


class CorruptStore(CoilcalError):
    """A file on disk is truncated, altered or of another schema version."""


class Faults:
    """What is wrong with a file: the first fault is raised, or all of them are noted.

    Code that continues after a fault puts a substitute in place of what could not be read.

    Examples:
        >>> faults = Faults(is_collected=True)
        >>> for text in ("1", "one", "l"):
        ...     with faults.noting():
        ...         if not text.isdecimal():
        ...             raise InvalidInput(f"a cell must be a number; received {text}")
        >>> [str(fault) for fault in faults.noted]
        ['a cell must be a number; received one', 'a cell must be a number; received l']
    """

    def __init__(self, is_collected: bool = False) -> None:
        self.is_collected = is_collected
        self.noted: list[InvalidInput] = []

    def note(self, fault: InvalidInput) -> None:
        """Note a fault, or raise it."""
        if not self.is_collected:
            raise fault
        self.noted.append(fault)

    def noting(self) -> AbstractContextManager[None, bool]:
        """Note a fault that is raised inside, and continue after the block."""
        return _Noting(self)


class _Noting(AbstractContextManager[None, bool]):
    def __init__(self, faults: Faults) -> None:
        self._faults = faults

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, fault: BaseException | None, traceback: object) -> bool:
        if not self._faults.is_collected or not isinstance(fault, InvalidInput):
            return False
        self._faults.noted.append(fault)
        return True


def in_order(faults: Iterable[InvalidInput]) -> list[InvalidInput]:
    """Faults of a file in the order of their lines; first those that have none."""
    return sorted(
        faults, key=lambda fault: (fault.place.line, fault.place.column or 0) if fault.place else (0, 0)
    )


def closest(name: str, known: Iterable[str]) -> str:
    """The known name that may have been meant, as the end of a sentence; nothing where none is like it.

    Examples:
        >>> closest("raduis_mm", ["radius_mm", "wire_radius_mm"]), closest("colour", ["radius_mm"])
        ('; the closest is radius_mm', '')
    """
    nearest = nearest_name(name, known)
    return "" if nearest is None else f"; the closest is {nearest}"


def check_known(rule: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse unknown names.

    Args:
        rule: What names must be, such as "currents must name coils of the rig".
        given, known: The names.
    Raises:
        InvalidInput: One of them is not known.
    Examples:
        >>> check_known("currents must name coils of the rig", ["coil3"], ["coil1"])
        Traceback (most recent call last):
        estimator.errors.InvalidInput: currents must name coils of the rig (coil1); received 'coil3'; the closest is coil1
    """
    names = list(known)
    for name in given:
        if name not in names:
            raise InvalidInput(
                f"{rule} ({', '.join(names) or 'none'}); received {quoted(name)}{closest(name, names)}"
            )


def nearest_name(name: str, known: Iterable[str]) -> str | None:
    """The known name that is most like this one; None where none is like it."""
    return next(iter(get_close_matches(name, sorted(known), n=1, cutoff=LEAST_LIKENESS)), None)


def cut(text: str, most: int = MOST_QUOTED) -> str:
    """A text from a file or a user, shortened for a sentence.

    Examples:
        >>> cut("1" * 5000, 10)
        '1111111111...'
    """
    return text if len(text) <= most else f"{text[:most]}..."


def listed(first: Iterable[str], n: int) -> str:
    """The first of `n` things, and how many more there are.

    Examples:
        >>> listed(["2", "3"], 2), listed(["2", "3"], 5)
        ('2, 3', '2, 3 and 3 more')
    """
    shown = list(first)
    return ", ".join(shown) + (f" and {n - len(shown)} more" if n > len(shown) else "")


def quoted(value: object) -> str:
    """A value from a file or a user, as messages quote it: text in quotes, long values shortened.

    Examples:
        >>> quoted("1.2.3"), quoted(7), quoted("9" * 5000)
        ("'1.2.3'", '7', "'999999999999999999999999999999999999999999999999999999999999...'")
    """
    return repr(cut(value)) if isinstance(value, str) else cut(_repr(value))


def _repr(value: object) -> str:
    try:
        return repr(value)
    except ValueError:  # of a whole number with thousands of digits
        return f"a {type(value).__name__} of thousands of digits"


def reason(error: Exception) -> str:
    """Cause of an error in words; for a file, without the path, which the message names already.

    Examples:
        >>> reason(FileNotFoundError(2, "No such file or directory", "rig.yaml"))
        'No such file or directory'
    """
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
