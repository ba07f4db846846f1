r"""Lake Shore 460 gaussmeter over RS-232, 9600 baud, 7 bits, odd parity; lines end with CR LF.

Protocol: as used by the MPIMeasurements.jl driver (`LakeShore460GaussMeter.jl`), after part 3.4 and chapter 4 of the
manual. Fields come without their prefix: `FIELDM?` tells whether the channel chosen with `CHNL` sends u, m, k or plain
tesla, and this changes with the range. So the range is fixed during set-up and the prefixes are read then.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.deadline import Deadline
from drivers.errors import DeviceFault, Refused
from drivers.hall.sensor import HallSensor
from drivers.on_channel import identity_landmark
from drivers.port_settings import port_of
from drivers.protocols import Reading, Vector
from drivers.readings import ascii_text, number, over_range, quoted
from drivers.settings import Settings
from drivers.transport.port import Port
from drivers.transport.serial_port import SerialSettings

SERIAL = SerialSettings(9600, data_bits=7, parity="O")

RANGES_T = (3.0, 0.3, 0.03, 0.003)
"""Full scale of `RANGE 0` to `RANGE 3` with a high-sensitivity probe (manual, part 3.4, page 3-7)."""

UPDATE_S = 0.25
"""Time between two readings of the instrument; its answers do not say whether they are new."""

_PREFIXES = {"u": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3}
_COMMAND_GAP_S = 0.05
"""Time that the instrument needs for a command; commands have no answer."""


def choose_range(highest_T: float) -> int:
    """Number of the most sensitive range that holds a field.

    Raises:
        Refused: The field is beyond every range.

    Examples:
        >>> choose_range(0.02), choose_range(0.2)
        (2, 1)
    """
    fitting = [index for index, full_scale_T in enumerate(RANGES_T) if highest_T <= full_scale_T]
    if not fitting:
        raise Refused(f"sensor.range_T must be at most {RANGES_T[0]}; received {highest_T}")
    return fitting[-1]


def decode_prefix(text: str) -> float:
    """Tesla per unit of a channel, from the answer to `FIELDM?`.

    Examples:
        >>> decode_prefix("m"), decode_prefix(" ")
        (0.001, 1.0)
    """
    try:
        return _PREFIXES[text.strip()]
    except KeyError as error:
        raise DeviceFault(f"460 must send a prefix u, m, k or none; received {quoted(text)}") from error


def decode_fields(text: str, tesla_per_unit: Vector) -> Vector:
    """Field from the answer to `ALLF?`: x, y, z and a fourth number, which is not used.

    Args:
        text: `OL` stands for a component beyond its range; it becomes NaN.
        tesla_per_unit: From `FIELDM?` of each channel.

    Examples:
        >>> decode_fields("+12.50,-0.25, OL ,+00.00", (1e-3, 1e-3, 1e-3))
        (0.0125, -0.00025, nan)
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 4:
        raise DeviceFault(f"460 must send four fields; received {quoted(text)}")
    x_T, y_T, z_T = (
        math.nan if part == "OL" else number(part, "a field of the 460") * scale
        for part, scale in zip(parts, tesla_per_unit, strict=False)
    )
    return x_T, y_T, z_T


class LakeShore460(HallSensor):
    """A `FieldSensor` in one fixed range.

    The instrument has no buffer and no time stamps. A new reading is there one update after the last, and a fresh one after two, for the
    first may hold an older field.
    """

    def __init__(self, port: Port, *, range_T: float, update_s: float = UPDATE_S) -> None:
        super().__init__(port, landmark=identity_landmark(b"\r\n", b"\r\n"))
        self._range = choose_range(range_T)
        self._update_s = update_s
        self._tesla_per_unit: Vector = (math.nan, math.nan, math.nan)

    def _identity(self, deadline: Deadline) -> str:
        return self._ask("*IDN?", deadline)

    def _read_fresh(self, deadline: Deadline) -> Reading[Vector]:
        return self._read(2 * self._update_s, deadline)

    def _read_new(self, deadline: Deadline) -> list[Reading[Vector]]:
        return [self._read(self._update_s, deadline)]

    def _read(self, wait_s: float, deadline: Deadline) -> Reading[Vector]:
        deadline.sleep(wait_s, "460 must have measured")
        field_T = decode_fields(self._ask("ALLF?", deadline), self._tesla_per_unit)
        return self._counter.reading(field_T, over_range(field_T))

    def _set_up(self, deadline: Deadline) -> None:
        self._tell("UNIT T", deadline)
        x, y, z = (self._set_up_channel(name, deadline) for name in "XYZ")
        self._tesla_per_unit = (x, y, z)

    def _set_up_channel(self, name: str, deadline: Deadline) -> float:
        for command in (f"CHNL {name}", "ACDC 0", "AUTO 0", f"RANGE {self._range}"):
            self._tell(command, deadline)
        chosen = self._ask("RANGE?", deadline)
        if chosen.strip() != str(self._range):
            raise DeviceFault(
                f"460 must be in range {self._range} on channel {name}; it says {quoted(chosen)}"
            )
        return decode_prefix(self._ask("FIELDM?", deadline))

    def _tell(self, command: str, deadline: Deadline) -> None:
        self._channel.send(f"{command}\r\n".encode("ascii"), deadline)
        deadline.sleep(_COMMAND_GAP_S, f"460 must take {command}")

    def _ask(self, question: str, deadline: Deadline) -> str:
        return ascii_text(self._channel.query(f"{question}\r\n".encode("ascii"), b"\r\n", deadline)).strip()


def opener(settings: Settings) -> Callable[[], LakeShore460]:
    """What opens it, by its settings in a rig file."""
    range_T = settings.quantity("range", "field")
    settings.judged_by(lambda: choose_range(range_T))
    port = port_of(settings, SERIAL)
    return lambda: LakeShore460(port.open(), range_T=range_T)
