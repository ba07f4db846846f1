r"""Commands of power supplies that speak SCPI, and of the Kepco BOP, which departs from it.

Protocol: SCPI-99, volume 2 (chapters on OUTPut, SOURce, MEASure, SYSTem). Every command is followed by `SYST:ERR?` in the same
line, so an error is reported with its own command. `*RST` is never sent: a Keysight E3633A is set to 20 A after it. `OUTP:PROT:WDOG` is not
part of SCPI-99; the Keysight N6700, N6900, N7900 and RP7900 and supplies of Kikusui have it, with delays of 1 to 3600 s.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial

from drivers.deadline import Deadline
from drivers.errors import DeviceFault, Refused
from drivers.port_settings import SCPI_SERIAL, port_of
from drivers.readings import ascii_text, number, quoted
from drivers.settings import Settings
from drivers.supplies.commands import Measured, Rating, SupplyOpener
from drivers.transport.channel import Channel, Landmark
from drivers.transport.port import Port

_FLOW_CONTROL = "\x11\x13"
"""XON and XOFF, which a Kepco leaves in its answers."""

STEP_S = 0.1
"""Time between two set-points; at 9600 baud, writing one and reading it back take 80 characters."""

_NO_ERROR_STATE = re.compile(rb'[^"]*[A-Za-z][^"]*,[^"]*')
"""Matches the answer to `*IDN?`, the only one without the quotation marks of an error state."""

_WATCHDOGS_S = (4, 3600)
"""Delays of the watchdog of a supply, in seconds: a busy computer asks no more often than once a second for sure."""

_COMPLIANCE_SHARE = 0.98
"""From this fraction of the voltage limit on, the supply is taken to regulate the voltage."""


@dataclass(frozen=True, slots=True)
class ScpiDialect:
    """How a model departs from plain SCPI.

    Attributes:
        preparation: Commands for remote control and current regulation; `{compliance_V}` is filled in.
        remote: Commands without which it does not obey; sent also where no answer is read.
        terminator: End of a line sent.
        longest_line: Largest number of bytes in a line sent; 0 for no limit.
        has_watchdog: Some supplies of this dialect switch off after a silence.
    """

    preparation: tuple[str, ...]
    remote: tuple[str, ...] = ()
    terminator: str = "\n"
    longest_line: int = 0
    has_watchdog: bool = False


GENERIC = ScpiDialect(("VOLT {compliance_V:g}",), has_watchdog=True)

KEPCO_BOP = ScpiDialect(
    ("SYST:REM 1", "FUNC:MODE CURR", "VOLT {compliance_V:g}"), remote=("SYST:REM 1",), longest_line=127
)
"""Kepco BOP with its RS-232 or IEEE 488 card. A current beyond its range gives error -222. Never send it `DIAG:TST?`, which
swings the output from one maximum to the other."""


def encode_line(command: str, dialect: ScpiDialect) -> bytes:
    r"""A line with a command or query, and the query for its error.

    Raises:
        DeviceFault: The line is longer than the device can take.

    Examples:
        >>> encode_line("CURR 1.5", GENERIC)
        b'CURR 1.5;:SYST:ERR?\n'
    """
    line = f"{command};:SYST:ERR?{dialect.terminator}"
    if dialect.longest_line and len(line) > dialect.longest_line:
        raise DeviceFault(
            f"a line must have at most {dialect.longest_line} bytes; {command!r} makes it {len(line)}"
        )
    return line.encode("ascii")


def decode_line(line: bytes, n_answers: int, command: str) -> list[str]:
    r"""The answers in a line that ends with the answer to `SYST:ERR?`.

    Raises:
        DeviceFault: The device reports an error, or gives another number of answers.

    Examples:
        >>> decode_line(b'\x13+1.499E+00;0,"No error"\x11', 1, "MEAS:CURR?")
        ['+1.499E+00']
        >>> decode_line(b'-222,"Data out of range"', 0, "CURR 99")
        Traceback (most recent call last):
        ...
        drivers.errors.DeviceFault: supply must accept CURR 99; it says -222,"Data out of range"
    """
    text = ascii_text(line).translate({ord(character): None for character in _FLOW_CONTROL}).strip()
    *answers, error = text.split(";", n_answers)
    if len(answers) != n_answers or "," not in error:
        raise DeviceFault(
            f"supply must give {n_answers} answers and its error state to {command}; received {quoted(line)}"
        )
    if number(error.split(",")[0], "an error of the supply") != 0:
        raise DeviceFault(f"supply must accept {command}; it says {error}")
    return [answer.strip() for answer in answers]


class ScpiSupply:
    """The commands of a supply that speaks SCPI."""

    step_s = STEP_S

    def __init__(
        self,
        port: Port,
        *,
        dialect: ScpiDialect = GENERIC,
        lowest_A: float,
        highest_A: float,
        compliance_V: float,
        resolution_A: float,
        watchdog_s: float | None = None,
    ) -> None:
        landmark = Landmark(f"*IDN?{dialect.terminator}".encode("ascii"), b"\n", _NO_ERROR_STATE)
        self._channel = Channel(port, find_step=landmark.find)
        self._dialect, self._compliance_V = dialect, compliance_V
        self.name = port.name
        self.lowest_A, self.highest_A, self.resolution_A = lowest_A, highest_A, resolution_A
        self.watchdog_s = watchdog_s

    def identify(self, deadline: Deadline) -> str:
        """See `SupplyCommands.identify`; asked in its own line, because names may hold a semicolon."""
        with self._channel.exchange(deadline):
            line = self._channel.query(f"*IDN?{self._dialect.terminator}".encode("ascii"), b"\n", deadline)
            return ascii_text(line).strip(_FLOW_CONTROL + " \r")

    def prepare(self, deadline: Deadline) -> None:
        """See `SupplyCommands.prepare`."""
        for command in self._dialect.preparation:
            self._ask(command.format(compliance_V=self._compliance_V), 0, deadline)
        if self.watchdog_s is not None:
            self._ask(f"OUTP:PROT:WDOG:DEL {self.watchdog_s:g}", 0, deadline)
            self._ask("OUTP:PROT:WDOG ON", 0, deadline)

    def write_set_point(self, current_A: float, deadline: Deadline) -> None:
        """See `SupplyCommands.write_set_point`."""
        self._ask(f"CURR {current_A:.6g}", 0, deadline)

    def read_set_point_A(self, deadline: Deadline) -> float:
        """See `SupplyCommands.read_set_point_A`."""
        return number(self._ask("CURR?", 1, deadline)[0], "a set-point")

    def switch_output(self, is_on: bool, deadline: Deadline) -> None:
        """See `SupplyCommands.switch_output`."""
        self._ask("OUTP ON" if is_on else "OUTP OFF", 0, deadline)

    def is_output_on(self, deadline: Deadline) -> bool:
        """See `SupplyCommands.is_output_on`."""
        answer = self._ask("OUTP?", 1, deadline)[0]
        if answer.upper() not in {"0", "1", "ON", "OFF"}:
            raise DeviceFault(
                f"supply must say whether its output is on; received {quoted(answer)} ({self.name})"
            )
        return answer.upper() in {"1", "ON"}

    def send_set_point(self, current_A: float, deadline: Deadline) -> None:
        """See `SupplyCommands.send_set_point`."""
        self._tell(f"CURR {current_A:.6g}", deadline)

    def cut(self, deadline: Deadline) -> None:
        """See `SupplyCommands.cut`; each command in a line of its own, for one that is refused must not stop the next.

        Errors are cleared afterwards (`*CLS`): nobody has read them, and they would be taken for those of the next command.
        """
        for command in (*self._dialect.remote, "CURR 0", "OUTP OFF", "*CLS"):
            self._tell(command, deadline)

    def measure(self, deadline: Deadline) -> Measured:
        """See `SupplyCommands.measure`."""
        current, voltage = self._ask("MEAS:CURR?;:MEAS:VOLT?", 2, deadline)
        is_limited = abs(number(voltage, "a voltage")) >= _COMPLIANCE_SHARE * self._compliance_V
        return Measured(number(current, "a current"), not is_limited)

    def disarm(self, deadline: Deadline) -> None:
        """See `SupplyCommands.disarm`."""
        if self.watchdog_s is not None:
            self._ask("OUTP:PROT:WDOG OFF", 0, deadline)

    def close(self) -> None:
        """See `SupplyCommands.close`."""
        self._channel.close()

    def _tell(self, command: str, deadline: Deadline) -> None:
        self._channel.send_unasked(f"{command}{self._dialect.terminator}".encode("ascii"), deadline)

    def _ask(self, command: str, n_answers: int, deadline: Deadline) -> list[str]:
        with self._channel.exchange(deadline):
            line = self._channel.query(encode_line(command, self._dialect), b"\n", deadline)
            return decode_line(line, n_answers, command)


def opener(settings: Settings, rating: Rating, dialect: ScpiDialect) -> SupplyOpener:
    """What opens it, by its settings in a rig file."""
    port = port_of(settings, SCPI_SERIAL)
    make = partial(
        ScpiSupply,
        dialect=dialect,
        lowest_A=rating.lowest_A,
        highest_A=rating.highest_A,
        compliance_V=rating.compliance_V,
        resolution_A=rating.tolerance_A,
        watchdog_s=_watchdog_s(settings) if dialect.has_watchdog else None,
    )
    return SupplyOpener(port, make)


def _watchdog_s(settings: Settings) -> float | None:
    """Delay of the watchdog of a supply that has one; None if the settings state none."""
    if not settings.has_quantity("watchdog", "time"):
        return None
    watchdog_s = settings.quantity("watchdog", "time")
    with settings.noting():
        if not (_WATCHDOGS_S[0] <= watchdog_s <= _WATCHDOGS_S[1] and watchdog_s == round(watchdog_s)):
            raise Refused(
                f"{settings.location}.watchdog_s must be whole seconds from {_WATCHDOGS_S[0]} to {_WATCHDOGS_S[1]}; "
                f"received {watchdog_s:g}"
            )
    return watchdog_s
