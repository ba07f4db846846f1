"""Korad KA3005P, unipolar, 30 V and 5 A; its serial port runs at 9600 8N1.

Protocol: "Series remote control syntax V2.0", as in the public drivers. Commands and answers have no terminator, so the
length of an answer must be known. There is no error queue, so every set-point is read back. Commands within 80 ms of each
other get lost. Some firmware adds a sixth character to the answer to `ISET1?`; it is discarded before the next command.
"""

from __future__ import annotations

import re
import time
from functools import partial

from drivers.deadline import Deadline
from drivers.errors import DeviceFault
from drivers.port_settings import port_of
from drivers.readings import ascii_text, number
from drivers.settings import Settings
from drivers.supplies.commands import Measured, Rating, SupplyOpener
from drivers.transport.channel import Channel
from drivers.transport.port import Port
from drivers.transport.serial_port import SerialSettings

SERIAL = SerialSettings(9600)

HIGHEST_A = 5.0
RESOLUTION_A = 1e-3

_GAP_S = 0.1
STEP_S = 0.25
"""Time between two set-points: two gaps, for the set-point and for reading it back, and the answer."""

_NUMBER_BYTES = 5
_NAME = re.compile(rb"[A-Z]{3}")
_CONSTANT_VOLTAGE_BIT, _OUTPUT_BIT = 1 << 0, 1 << 6


def encode_current(current_A: float) -> bytes:
    """Command that requests a current.

    Examples:
        >>> encode_current(1.5)
        b'ISET1:1.500'
    """
    return f"ISET1:{current_A:.3f}".encode("ascii")


def encode_voltage(voltage_V: float) -> bytes:
    """Command that sets the voltage limit.

    Examples:
        >>> encode_voltage(12.0)
        b'VSET1:12.00'
    """
    return f"VSET1:{voltage_V:05.2f}".encode("ascii")


def decode_number(answer: bytes) -> float:
    """A number of five characters, such as an answer to `IOUT1?`.

    Examples:
        >>> decode_number(b"1.499")
        1.499
    """
    return number(ascii_text(answer), "an answer of the KA3005P")


def decode_status(answer: bytes) -> tuple[bool, bool]:
    """Whether the output is on, and whether the supply holds the current.

    As in the public drivers: bit 0 set means constant voltage, bit 6 set means output on.

    Examples:
        >>> decode_status(bytes([0b0100_0000]))
        (True, True)
    """
    status = answer[0]
    return bool(status & _OUTPUT_BIT), not status & _CONSTANT_VOLTAGE_BIT


class KoradKA3005P:
    """The commands of a KA3005P."""

    lowest_A = 0.0
    resolution_A = RESOLUTION_A
    step_s = STEP_S
    watchdog_s: float | None = None

    def __init__(self, port: Port, *, compliance_V: float, highest_A: float = HIGHEST_A) -> None:
        self._channel = Channel(port, find_step=self._find_step)
        self._compliance_V = compliance_V
        self._next_s = 0.0
        self.name = port.name
        self.highest_A = min(highest_A, HIGHEST_A)

    def identify(self, deadline: Deadline) -> str:
        """See `SupplyCommands.identify`; the length of this answer is unknown, so silence ends it."""
        with self._channel.exchange(deadline):
            self._send(b"*IDN?", deadline)
            first = self._channel.read_exactly(1, deadline)
            return ascii_text(first + self._channel.read_until_silent(_GAP_S, deadline)).strip("\0 \r\n")

    def prepare(self, deadline: Deadline) -> None:
        """See `SupplyCommands.prepare`."""
        with self._channel.exchange(deadline):
            self._send(encode_voltage(self._compliance_V), deadline)
            limit_V = decode_number(self._ask(b"VSET1?", _NUMBER_BYTES, deadline))
            if abs(limit_V - self._compliance_V) > 0.011:
                raise DeviceFault(f"supply must limit to {self._compliance_V:g} V; it says {limit_V:g} V")

    def write_set_point(self, current_A: float, deadline: Deadline) -> None:
        """See `SupplyCommands.write_set_point`."""
        with self._channel.exchange(deadline):
            self._send(encode_current(current_A), deadline)

    def read_set_point_A(self, deadline: Deadline) -> float:
        """See `SupplyCommands.read_set_point_A`."""
        with self._channel.exchange(deadline):
            return decode_number(self._ask(b"ISET1?", _NUMBER_BYTES, deadline))

    def switch_output(self, is_on: bool, deadline: Deadline) -> None:
        """See `SupplyCommands.switch_output`."""
        with self._channel.exchange(deadline):
            self._send(b"OUT1" if is_on else b"OUT0", deadline)

    def is_output_on(self, deadline: Deadline) -> bool:
        """See `SupplyCommands.is_output_on`."""
        with self._channel.exchange(deadline):
            return decode_status(self._ask(b"STATUS?", 1, deadline))[0]

    def send_set_point(self, current_A: float, deadline: Deadline) -> None:
        """See `SupplyCommands.send_set_point`."""
        self._tell(encode_current(current_A), deadline)

    def cut(self, deadline: Deadline) -> None:
        """See `SupplyCommands.cut`."""
        self._tell(encode_current(0.0), deadline)
        self._tell(b"OUT0", deadline)

    def measure(self, deadline: Deadline) -> Measured:
        """See `SupplyCommands.measure`."""
        with self._channel.exchange(deadline):
            current_A = decode_number(self._ask(b"IOUT1?", _NUMBER_BYTES, deadline))
            is_on, is_regulating = decode_status(self._ask(b"STATUS?", 1, deadline))
        return Measured(current_A, is_regulating or not is_on)

    def disarm(self, deadline: Deadline) -> None:
        """See `SupplyCommands.disarm`; it has no watchdog."""

    def close(self) -> None:
        """See `SupplyCommands.close`."""
        self._channel.close()

    def _find_step(self, channel: Channel, deadline: Deadline) -> None:
        """Find an answer that holds a name (see `Landmark`): other answers have at most one stray letter."""
        self._send(b"*IDN?", deadline)
        while not _NAME.search(
            channel.read_exactly(1, deadline) + channel.read_until_silent(_GAP_S, deadline)
        ):
            pass

    def _keep_distance(self, deadline: Deadline) -> None:
        deadline.sleep(
            max(0.0, self._next_s - time.monotonic()), "KA3005P must have taken the previous command"
        )

    def _tell(self, command: bytes, deadline: Deadline) -> None:
        self._keep_distance(deadline)
        self._channel.send_unasked(command, deadline)
        self._next_s = time.monotonic() + _GAP_S

    def _send(self, command: bytes, deadline: Deadline) -> None:
        self._keep_distance(deadline)
        self._channel.take_arrived(deadline)  # the stray sixth character of the previous answer
        self._channel.send(command, deadline)
        self._next_s = time.monotonic() + _GAP_S

    def _ask(self, question: bytes, n_bytes: int, deadline: Deadline) -> bytes:
        self._send(question, deadline)
        return self._channel.read_exactly(n_bytes, deadline)


def opener(settings: Settings, rating: Rating) -> SupplyOpener:
    """What opens it, by its settings in a rig file."""
    port = port_of(settings, SERIAL, has_messages=False)
    return SupplyOpener(
        port, partial(KoradKA3005P, compliance_V=rating.compliance_V, highest_A=rating.highest_A)
    )
