"""Interprets SCPI as an instrument does: short and long forms, several commands in a line, an error queue."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TypeAlias

Handler: TypeAlias = Callable[[str], str | None]
"""Takes the arguments of a command and returns the answer to a query; may raise ScpiError."""


class ScpiError(Exception):
    """An entry of the error queue, such as `-222,"Data out of range"`."""


def short_form(header: str) -> str:
    """Header in short form: four letters of each word, or three if the fourth is a vowel (SCPI-99, volume 1, 6.2.1).

    Examples:
        >>> short_form("SYSTem:ERRor:ALL?"), short_form(":outp"), short_form("*IDN?")
        ('SYST:ERR:ALL?', 'OUTP', '*IDN?')
    """
    words = header.strip().lstrip(":").upper().split(":")
    return ":".join(_shorten(word.removesuffix("?")) + "?" * word.endswith("?") for word in words)


def _shorten(word: str) -> str:
    if len(word) <= 4:
        return word
    return word[:3] if word[3] in "AEIOU" else word[:4]


class ScpiInstrument:
    """An instrument that answers lines by a table of handlers, and sends nothing unasked."""

    def __init__(self, handlers: dict[str, Handler], terminator: str) -> None:
        self._handlers: dict[str, Handler] = {
            **handlers,
            "SYST:ERR?": lambda _: self._errors.popleft() if self._errors else '0,"No error"',
            "SYST:ERR:ALL?": lambda _: self._all_errors(),
            "SYST:ERR:CLE": lambda _: self._errors.clear(),
            "*CLS": lambda _: self._errors.clear(),
        }
        self._terminator = terminator
        self._errors: deque[str] = deque()
        self._arrived = b""

    def take(self, data: bytes) -> bytes:
        """See `Instrument.take`."""
        *lines, self._arrived = (self._arrived + data).split(b"\n")
        return b"".join(self._answer(line.decode("ascii", "replace").strip()) for line in lines)

    def stream(self) -> bytes:
        """See `Instrument.stream`."""
        return b""

    def _answer(self, line: str) -> bytes:
        answers = [self._execute(command) for command in line.split(";") if command.strip()]
        text = ";".join(answer for answer in answers if answer is not None)
        return (text + self._terminator).encode("ascii") if text else b""

    def _execute(self, command: str) -> str | None:
        header, _, arguments = command.strip().partition(" ")
        handler = self._handlers.get(short_form(header))
        if handler is None:
            self._errors.append('-113,"Undefined header"')
            return None
        try:
            return handler(arguments.strip())
        except ScpiError as error:
            self._errors.append(str(error))
        except ValueError:
            self._errors.append('-104,"Data type error"')
        return None

    def _all_errors(self) -> str:
        errors = ",".join(self._errors) or '0,"No error"'
        self._errors.clear()
        return errors
