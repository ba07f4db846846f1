r"""Metrolab THM1176 three-axis Hall magnetometer, the sensor of the paper, over USBTMC (`VisaPort`).

Protocol: public Python drivers (pyTHM1176 of Hyperfine). The three axes are measured one after the other, each averaged over all its
samples before the next begins: about 5 ms apart at 100 samples, so the field must be constant meanwhile. `:CAL:INIT` and `:DIAG:UPGR`
write to the probe's flash, and `:MEAS` resets it: none of them is ever sent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.deadline import Deadline
from drivers.errors import DeviceFault, Refused
from drivers.hall.sensor import HallSensor
from drivers.on_channel import identity_landmark
from drivers.port_settings import SCPI_SERIAL, port_of
from drivers.protocols import Reading, ReadingFlag, Vector
from drivers.readings import ascii_text, number, quoted
from drivers.settings import Settings
from drivers.transport.port import Port

RANGES_T = (0.1, 0.3, 1.0, 3.0)

MEASURE = ":INIT;:FETC:ARR:X? 1,5;:FETC:ARR:Y? 1,5;:FETC:ARR:Z? 1,5;:FETC:TIM?;*STB?"
"""Start one acquisition and wait for it: five digits of each axis, the time stamp, and whether errors are queued."""

_OVER_RANGE, _OVERRUNS = 205, (204, 206)
_MOST_ERRORS = 20


@dataclass(frozen=True, slots=True)
class Acquisition:
    """The answer to `MEASURE`.

    Attributes:
        field_T: Along x, y, z of the probe.
        device_time_s: End of the acquisition, on the probe's clock.
        has_errors: Whether errors are queued.
    """

    field_T: Vector
    device_time_s: float
    has_errors: bool


def choose_range_T(highest_T: float) -> float:
    """The smallest range that holds a field.

    Raises:
        Refused: The field is beyond every range.

    Examples:
        >>> choose_range_T(0.05), choose_range_T(0.5)
        (0.1, 1.0)
    """
    fitting = [range_T for range_T in RANGES_T if highest_T <= range_T]
    if not fitting:
        raise Refused(f"sensor.range_T must be at most {RANGES_T[-1]}; received {highest_T}")
    return fitting[0]


def encode_setup(range_T: float, n_averaged: int) -> str:
    """Settings for single acquisitions that start at once.

    Examples:
        >>> encode_setup(0.1, 100)
        ':ABOR;:SENS:FLUX:RANG:AUTO OFF;:SENS:FLUX:RANG 0.1T;:AVER:COUN 100;:TRIG:SOUR IMM;:TRIG:COUN 1;:INIT:CONT OFF;*STB?'
    """
    return (
        f":ABOR;:SENS:FLUX:RANG:AUTO OFF;:SENS:FLUX:RANG {range_T:g}T;:AVER:COUN {n_averaged};"
        ":TRIG:SOUR IMM;:TRIG:COUN 1;:INIT:CONT OFF;*STB?"
    )


def decode_acquisition(line: str) -> Acquisition:
    """The answer to `MEASURE`.

    Raises:
        DeviceFault: The line has another format.

    Examples:
        >>> decode_acquisition("+0.00123 T;-0.00045 T;+0.01000 T;0x3B9ACA00;0")
        Acquisition(field_T=(0.00123, -0.00045, 0.01), device_time_s=1.0, has_errors=False)
    """
    parts = line.split(";")
    if len(parts) != 5 or not all(part.strip().endswith(" T") for part in parts[:3]):
        raise DeviceFault(f"THM1176 must send x T;y T;z T;time;status; received {quoted(line)}")
    x_T, y_T, z_T = (number(part.strip().removesuffix(" T"), "a field of the THM1176") for part in parts[:3])
    try:
        nanoseconds = int(parts[3], 16)
    except ValueError as error:
        raise DeviceFault(
            f"THM1176 must send its time in hexadecimal; received {quoted(parts[3])}"
        ) from error
    return Acquisition((x_T, y_T, z_T), nanoseconds * 1e-9, number(parts[4], "status of the THM1176") != 0)


class MetrolabTHM1176(HallSensor):
    """A `FieldSensor` that measures on demand and has no buffer."""

    def __init__(self, port: Port, *, range_T: float, n_averaged: int = 100) -> None:
        """Choose its settings.

        Args:
            port: Connection to the probe.
            range_T: Largest field to expect.
            n_averaged: Samples of each axis in a reading; a single one scatters by 0.5 mT.
        """
        super().__init__(port, landmark=identity_landmark(b"\n", b"\n"))
        self._range_T, self._n_averaged = choose_range_T(range_T), n_averaged
        self._last_time_s: float | None = None

    def _identity(self, deadline: Deadline) -> str:
        return self._ask("*IDN?", deadline)

    def _set_up(self, deadline: Deadline) -> None:
        status = self._ask(encode_setup(self._range_T, self._n_averaged), deadline)
        if number(status, "status of the THM1176") != 0:
            self._read_errors(deadline)

    def _read_fresh(self, deadline: Deadline) -> Reading[Vector]:
        acquisition = decode_acquisition(self._ask(MEASURE, deadline))
        flags = self._read_errors(deadline) if acquisition.has_errors else ReadingFlag.NONE
        if acquisition.device_time_s == self._last_time_s:
            flags |= ReadingFlag.STALE
        self._last_time_s = acquisition.device_time_s
        return self._counter.reading(acquisition.field_T, flags, device_time_s=acquisition.device_time_s)

    def _read_new(self, deadline: Deadline) -> list[Reading[Vector]]:
        return [self._read_fresh(deadline)]

    def _read_errors(self, deadline: Deadline) -> ReadingFlag:
        """Empty the queue of errors; errors of a reading become its flags, others raise."""
        flags = ReadingFlag.NONE
        for _ in range(_MOST_ERRORS):
            answer = self._ask(":SYST:ERR?", deadline)
            code = number(answer.split(",")[0], "an error of the THM1176")
            if code == 0:
                return flags
            if code == _OVER_RANGE:
                flags |= ReadingFlag.OVER_RANGE
            elif code in _OVERRUNS:
                flags |= ReadingFlag.DROPPED
            else:
                raise DeviceFault(f"THM1176 must accept its commands; it says {answer}")
        raise DeviceFault(f"THM1176 must queue fewer than {_MOST_ERRORS} errors; it has sent as many")

    def _ask(self, commands: str, deadline: Deadline) -> str:
        return ascii_text(self._channel.query(f"{commands}\n".encode("ascii"), b"\n", deadline)).strip()


def opener(settings: Settings) -> Callable[[], MetrolabTHM1176]:
    """What opens it, by its settings in a rig file."""
    range_T = settings.quantity("range", "field")
    settings.judged_by(lambda: choose_range_T(range_T))
    n_averaged = settings.whole_number("averaged_samples", 100)
    port = port_of(settings, SCPI_SERIAL)
    return lambda: MetrolabTHM1176(port.open(), range_T=range_T, n_averaged=n_averaged)
