r"""Lake Shore F71 teslameter, over its serial port (115200 8N1, RTS/CTS) or TCP port 7777.

Protocol: as used by Lake Shore's own Python driver (github.com/lakeshorecryotronics/python-driver, `teslameter.py`
and `xip_instrument.py`). Commands end with a line feed, answers with CR LF; `;:` joins several commands in one line.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from drivers.deadline import Deadline
from drivers.errors import DeviceFault
from drivers.hall.sensor import HallSensor
from drivers.on_channel import identity_landmark
from drivers.port_settings import port_of
from drivers.protocols import Reading, ReadingFlag, Vector
from drivers.readings import ICE_POINT_K, ReadingCounter, ascii_text, number, over_range, quoted
from drivers.settings import Settings
from drivers.transport.port import Port
from drivers.transport.serial_port import SerialSettings

SERIAL = SerialSettings(115200, has_rts_cts=True)
TCP_PORT = 7777

SAMPLE_S = 0.01
"""Sampling interval; each point of the buffer averages a whole number of samples."""

READ_BUFFER = ":FETC:BUFF:DC?;:STAT:OPER:COND?"
READ_TEMPERATURE = ":FETC:TEMP?"
"""Temperature of the probe in degrees Celsius; not a number if the probe has no thermometer."""

CLEAR_BUFFER = ":FETC:BUFF:CLE"
"""Discards the points in the buffer, as the NICOS driver does. A full buffer takes seconds over the serial line, so unwanted points are
cleared instead of read."""

_ERRORS = ";:SYST:ERR:ALL?"
_OVERLOAD_BIT = 1 << 1
_POLL_S = 0.004


@dataclass(frozen=True, slots=True)
class BufferPoint:
    """One point of the buffer.

    Attributes:
        device_time_s: Seconds since 1970 on the instrument's clock.
        field_T: Along x, y, z of the probe.
    """

    device_time_s: float
    field_T: Vector


def encode_setup(range_T: float | None, n_averaged: int) -> str:
    """Settings for DC readings in tesla.

    Args:
        range_T: Largest field to expect; None lets the instrument choose its range.
        n_averaged: Samples of 10 ms in one reading.

    Examples:
        >>> encode_setup(0.1, 5)
        ':SENS:MODE DC;:UNIT:FIEL TESLA;:SENS:RANG:AUTO 0;:SENS:RANG 0.1;:SENS:AVER:COUN 5'
    """
    ranging = ":SENS:RANG:AUTO 1" if range_T is None else f":SENS:RANG:AUTO 0;:SENS:RANG {range_T:g}"
    return f":SENS:MODE DC;:UNIT:FIEL TESLA;{ranging};:SENS:AVER:COUN {n_averaged}"


def split_answers(line: str) -> list[str]:
    """The answers in a line, without the quotation marks around a whole answer.

    Examples:
        >>> split_answers('"a;b";2;0,"No error"')
        ['a;b', '2', '0,"No error"']
    """
    quoted, answers = False, [""]
    for character in line:
        quoted ^= character == '"'
        if character == ";" and not quoted:
            answers.append("")
        else:
            answers[-1] += character
    return [answer[1:-1] if answer[:1] == answer[-1:] == '"' else answer for answer in answers]


def decode_buffer(text: str) -> list[BufferPoint]:
    """Points of the buffer, oldest first.

    Args:
        text: `time,magnitude,x,y,z,state;...`; a field controller puts its set-point before the state. The magnitude
            comes first and is not a component.

    Raises:
        DeviceFault: The text has another format.

    Examples:
        >>> decode_buffer("2026-11-21T08:00:00.010,0.3,0.1,-0.2,0.2,0;")
        [BufferPoint(device_time_s=1795248000.01, field_T=(0.1, -0.2, 0.2))]
    """
    points = []
    for entry in filter(None, text.split(";")):
        parts = entry.split(",")
        try:
            moment = datetime.fromisoformat(parts[0])
        except ValueError:
            moment = None
        if moment is None or len(parts) not in {6, 7}:
            raise DeviceFault(f"F71 must send time,magnitude,x,y,z,state; received {quoted(entry)}")
        x_T, y_T, z_T = (number(part, "a field of the F71") for part in parts[2:5])
        moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
        points.append(BufferPoint(moment.timestamp(), (x_T, y_T, z_T)))
    return points


class LakeShoreF71(HallSensor):
    """A `FieldSensor` that reads the instrument's buffer, so polling neither repeats nor misses a point; also a `Thermometer`."""

    def __init__(self, port: Port, *, range_T: float | None = None, n_averaged: int = 1) -> None:
        super().__init__(port, landmark=identity_landmark(b"\n", b"\r\n"))
        self._range_T, self._n_averaged = range_T, n_averaged
        self._last_time_s: float | None = None
        self._temperatures = ReadingCounter()

    def read_temperature_K(self, *, timeout_s: float) -> Reading[float]:
        """See `Thermometer.read_temperature_K`."""
        with self._ready(timeout_s) as deadline:
            (answer,) = self._ask(READ_TEMPERATURE, 1, deadline)
            return self._temperatures.reading(number(answer, "a temperature of the F71") + ICE_POINT_K)

    def _identity(self, deadline: Deadline) -> str:
        return self._ask("*IDN?", 1, deadline)[0]

    def _set_up(self, deadline: Deadline) -> None:
        self._ask(encode_setup(self._range_T, self._n_averaged), 0, deadline)
        self._ask(CLEAR_BUFFER, 0, deadline)

    def _read_fresh(self, deadline: Deadline) -> Reading[Vector]:
        self._ask(CLEAR_BUFFER, 0, deadline)
        self._last_time_s = None  # points cleared on purpose do not count as lost
        self._wait(deadline)  # the first point was begun before the call
        points, overload = self._wait(deadline)
        return self._reading(points[-1], overload, time.monotonic())

    def _read_new(self, deadline: Deadline) -> list[Reading[Vector]]:
        points, overload = self._wait(deadline)
        arrived_s = time.monotonic()
        return [self._reading(point, overload, arrived_s) for point in points]

    def _wait(self, deadline: Deadline) -> tuple[list[BufferPoint], ReadingFlag]:
        while not (fetched := self._fetch(deadline))[0]:
            deadline.sleep(_POLL_S, "F71 must have measured")
        return fetched

    def _fetch(self, deadline: Deadline) -> tuple[list[BufferPoint], ReadingFlag]:
        buffer, condition = self._ask(READ_BUFFER, 2, deadline)
        status = number(condition, "F71 status")
        if not status.is_integer():
            raise DeviceFault(f"F71 must send its status as a whole number; received {quoted(condition)}")
        is_overload = int(status) & _OVERLOAD_BIT
        return decode_buffer(buffer), ReadingFlag.OVER_RANGE if is_overload else ReadingFlag.NONE

    def _reading(self, point: BufferPoint, overload: ReadingFlag, arrived_s: float) -> Reading[Vector]:
        flags = overload | over_range(point.field_T)
        if self._last_time_s is not None:
            step_s = point.device_time_s - self._last_time_s
            if step_s <= 0:
                flags |= ReadingFlag.STALE
            elif step_s > 1.5 * SAMPLE_S * self._n_averaged:
                self._counter.note_loss()
        self._last_time_s = point.device_time_s
        return self._counter.reading(
            point.field_T, flags, host_monotonic_s=arrived_s, device_time_s=point.device_time_s
        )

    def _ask(self, commands: str, n_answers: int, deadline: Deadline) -> list[str]:
        line = self._channel.query(f"{commands}{_ERRORS}\n".encode("ascii"), b"\r\n", deadline)
        *answers, errors = split_answers(ascii_text(line))
        if len(answers) != n_answers:
            raise DeviceFault(f"F71 must give {n_answers} answers to {commands}; received {quoted(line)}")
        if not errors.startswith("0,"):
            raise DeviceFault(f"F71 must accept {commands}; it says {errors}")
        return answers


def opener(settings: Settings) -> Callable[[], LakeShoreF71]:
    """What opens it, by its settings in a rig file."""
    has_range = settings.has_quantity("range", "field")
    range_T = settings.quantity("range", "field") if has_range else None
    n_averaged = settings.whole_number("averaged_samples", 1)
    port = port_of(settings, SERIAL, TCP_PORT)
    return lambda: LakeShoreF71(port.open(), range_T=range_T, n_averaged=n_averaged)
