r"""Lake Shore 224 temperature monitor, over USB serial (57600 baud, 7 bits, odd parity) or TCP port 7777.

Protocol: as used by Lake Shore's own Python driver (github.com/lakeshorecryotronics/python-driver, `model_224.py`). Questions end
with a line feed, answers with CR LF, and `;` joins several in one line. The manuals of the models 218, 335, 336 and 350 have the same
two questions (a 218 needs `baud: 9600`, and its inputs are 1 to 8); only the 224 has been checked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from drivers.deadline import Deadline
from drivers.errors import DeviceFault, Refused
from drivers.on_channel import OnChannel, identity_landmark
from drivers.protocols import Reading
from drivers.readings import ReadingCounter, ascii_text, number, quoted
from drivers.transport.port import Port
from drivers.transport.serial_port import SerialSettings

SERIAL = SerialSettings(57600, data_bits=7, parity="O")
TCP_PORT = 7777

_INPUT = re.compile(r"[A-D][1-5]?|[1-8]")
_NO_NUMBER_BITS = 0b1111_0001
"""Bits of `RDGST?`: reading invalid, temperature and sensor below or above their ranges (manual of the 340, page 9-40)."""


def encode_question(name: str) -> str:
    """Question for the temperature of an input and its status, without which an open input would read 0 K.

    Examples:
        >>> encode_question("C1")
        'KRDG? C1;RDGST? C1'
    """
    return f"KRDG? {name};RDGST? {name}"


def decode_kelvin(line: str) -> float:
    """Temperature in kelvin from the answer to `encode_question`; NaN if the status marks it invalid.

    Raises:
        DeviceFault: The line has another format.

    Examples:
        >>> decode_kelvin("+295.150;000"), decode_kelvin("+0.00000;128")
        (295.15, nan)
    """
    temperature, _, status = line.partition(";")
    if not status.strip().isdigit():
        raise DeviceFault(f"224 must send kelvin;status; received {quoted(line)}")
    kelvin = number(temperature, "a temperature of the 224")
    return math.nan if int(status) & _NO_NUMBER_BITS else kelvin


def check_inputs(inputs: Mapping[str, str]) -> None:
    """Refuse an input that the monitor has not got.

    Raises:
        Refused: Which one, and those that there are.
    """
    for target, name in inputs.items():
        if not _INPUT.fullmatch(name):
            raise Refused(f"thermometer.inputs.{target} must be A, B, C1 to C5 or D1 to D5; received {name}")


class LakeShore224(OnChannel):
    """A `TemperatureMonitor`; types and curves of the inputs are chosen at its panel.

    Attributes:
        thermometers: Thermometers by the coil or sensor that each is fixed to.
    """

    def __init__(self, port: Port, inputs: Mapping[str, str]) -> None:
        """Own a port.

        Args:
            port: Connection to the monitor.
            inputs: Input of each thermometer (A, B, C1 to C5, D1 to D5), by the coil or sensor that it is fixed to.
        """
        check_inputs(inputs)
        super().__init__(port, landmark=identity_landmark(b"\n", b"\r\n"))
        self.thermometers = {target: MonitorInput(self, name) for target, name in inputs.items()}

    def read_input_K(self, name: str, *, timeout_s: float) -> float:
        """Temperature at one input; NaN if there is no number."""
        with self._ready(timeout_s) as deadline:
            return decode_kelvin(self._ask(encode_question(name), deadline))

    def _identity(self, deadline: Deadline) -> str:
        return self._ask("*IDN?", deadline)

    def _ask(self, questions: str, deadline: Deadline) -> str:
        return ascii_text(self._channel.query(f"{questions}\n".encode("ascii"), b"\r\n", deadline)).strip()


class MonitorInput:
    """The `Thermometer` at one input of a monitor."""

    def __init__(self, monitor: LakeShore224, name: str) -> None:
        self._monitor, self._name = monitor, name
        self._counter = ReadingCounter()

    def read_temperature_K(self, *, timeout_s: float) -> Reading[float]:
        """See `Thermometer.read_temperature_K`."""
        return self._counter.reading(self._monitor.read_input_K(self._name, timeout_s=timeout_s))
