"""Simulated Hall sensors: Lake Shore F71 and 460, Senis 3MH6, Metrolab THM1176."""

from __future__ import annotations

import math
import time
from datetime import UTC, datetime
from functools import partial

from drivers.hall import lakeshore_460, senis_3mh6
from drivers.hall.lakeshore_f71 import SAMPLE_S
from drivers.hall.senis_3mh6 import Packet, encode_packet
from drivers.protocols import Vector
from drivers.readings import ICE_POINT_K
from drivers.simulated.scpi import ScpiError, ScpiInstrument
from drivers.simulated.world import FieldFunction, Snapshot, World

_BUFFER_POINTS = 1000
_CHIP_WARMTH_K = 3.0
"""Temperature rise of a probe above the room."""


class SimulatedF71(ScpiInstrument):
    """A Lake Shore F71, whose buffer fills on its own clock."""

    def __init__(self, world: World, field: FieldFunction, full_scale_T: float = 0.35) -> None:
        self._world, self._field, self._full_scale_T = world, field, full_scale_T
        self._n_averaged = 1
        self._settings = {"SENS:MODE": "DC", "UNIT:FIEL": "TESLA", "SENS:RANG:AUTO": "1", "SENS:RANG": "0"}
        self._next_s = time.monotonic()
        self._clock_offset_s = time.time() - self._next_s
        self._points: list[tuple[float, Snapshot]] = []
        self._latest = world.snapshot()
        super().__init__(
            {
                "*IDN?": lambda _: "LSCI,F71,LSA0001/LSA0002,1.6.2019101001",
                "FETC:DC?": self._fetch,
                "FETC:TEMP?": lambda _: f"{_chip_C(world.snapshot()):.3f}",
                "FETC:BUFF:CLE": lambda _: self._points.clear(),
                "FETC:BUFF:DC?": lambda _: self._fetch_buffer(),
                "STAT:OPER:COND?": lambda _: str(2 * self._is_overload()),
                "SENS:AVER:COUN": self._set_averaging,
                "SENS:AVER:COUN?": lambda _: str(self._n_averaged),
                "PROB:SNUM?": lambda _: "LSA0003",
                **{name: partial(self._set, name) for name in self._settings},
                **{f"{name}?": partial(self._get, name) for name in self._settings},
            },
            "\r\n",
        )

    def stream(self) -> bytes:
        """See `Instrument.stream`; sends nothing but fills the buffer.

        A point is the state of the world, whose field is computed when it is read: a computed field may take longer than a sample, and
        most points are cleared unread.
        """
        if (now_s := time.monotonic()) >= self._next_s:
            self._latest = self._world.snapshot()
            self._points.append((self._next_s + self._clock_offset_s, self._latest))
            del self._points[:-_BUFFER_POINTS]
            # After a stall the clock continues from now: the points in between were never measured.
            self._next_s += (
                SAMPLE_S * self._n_averaged * (1 + int((now_s - self._next_s) / SAMPLE_S / self._n_averaged))
            )
        return b""

    def _set(self, name: str, value: str) -> None:
        self._settings[name] = value

    def _get(self, name: str, _: str) -> str:
        return self._settings[name]

    def _set_averaging(self, value: str) -> None:
        n_averaged = round(float(value))  # Lake Shore's driver writes 10.0
        if not 1 <= n_averaged <= 100000:
            raise ScpiError('-222,"Data out of range"')
        self._n_averaged = n_averaged
        self._points.clear()

    def _is_overload(self) -> bool:
        return any(abs(value_T) > self._full_scale_T for value_T in self._field(self._latest))

    def _scale(self) -> float:
        return {"TESLA": 1.0, "GAUSS": 1e4}.get(self._settings["UNIT:FIEL"], 1.0)

    def _fetch(self, arguments: str) -> str:
        x, y, z = (self._scale() * value_T for value_T in self._field(self._world.snapshot()))
        values = (math.hypot(x, y, z), x, y, z) if arguments.upper() == "ALL" else (math.hypot(x, y, z),)
        return ",".join(f"{value:.9E}" for value in values)

    def _fetch_buffer(self) -> str:
        entries = "".join(self._entry(time_s, self._field(moment)) for time_s, moment in self._points)
        self._points.clear()
        return f'"{entries}"'

    def _entry(self, time_s: float, field_T: Vector) -> str:
        moment = datetime.fromtimestamp(time_s, UTC).isoformat(timespec="microseconds")
        x, y, z = (self._scale() * value_T for value_T in field_T)
        return f"{moment},{math.hypot(x, y, z):.9E},{x:.9E},{y:.9E},{z:.9E},0;"


class Simulated460:
    """A Lake Shore 460: commands without answers, one active channel, prefixes that follow the range."""

    def __init__(self, world: World, field: FieldFunction, update_s: float = lakeshore_460.UPDATE_S) -> None:
        self._world, self._field, self._update_s = world, field, update_s
        self._channel = "X"
        self._ranges = {"X": 0, "Y": 0, "Z": 0}
        self._is_auto = {"X": True, "Y": True, "Z": True}
        self._is_gauss = True
        self._arrived = b""
        self._measured = world.snapshot()
        self._next_s = 0.0

    def take(self, data: bytes) -> bytes:
        """See `Instrument.take`."""
        *lines, self._arrived = (self._arrived + data).split(b"\r\n")
        answers = (
            self._execute(*line.decode("ascii", "replace").upper().partition(" ")[::2]) for line in lines
        )
        return b"".join(f"{answer}\r\n".encode("ascii") for answer in answers if answer is not None)

    def stream(self) -> bytes:
        """See `Instrument.stream`; sends nothing but renews the display, whose field is computed when it is read."""
        if (now_s := time.monotonic()) >= self._next_s:
            self._measured = self._world.snapshot()
            self._next_s = now_s + self._update_s
        return b""

    def _execute(self, command: str, argument: str) -> str | None:
        match command:
            case "*IDN?":
                return "LSCI,MODEL460,0,032406"
            case "ALLF?":
                shown = (self._shown(*pair) for pair in zip("XYZ", self._field(self._measured), strict=True))
                return ",".join([*shown, "+0.000"])
            case "FIELDM?":
                return self._prefix(self._channel)
            case "RANGE?":
                return str(self._ranges[self._channel])
            case "CHNL" if argument in self._ranges:
                self._channel = argument
            case "RANGE" if argument in {"0", "1", "2", "3"}:
                self._ranges[self._channel] = int(argument)
            case "AUTO":
                self._is_auto[self._channel] = argument == "1"
            case "UNIT":
                self._is_gauss = argument == "G"
        return None

    def _prefix(self, channel: str) -> str:
        return "" if self._ranges[channel] == 0 else "m"

    def _shown(self, channel: str, field_T: float) -> str:
        full_scale_T = lakeshore_460.RANGES_T[self._ranges[channel]]
        if abs(field_T) > full_scale_T:
            return "OL"
        scale = (1e3 if self._prefix(channel) == "m" else 1.0) * (1e4 if self._is_gauss else 1.0)
        return f"{scale * field_T:+.5f}"


class SimulatedSenis:
    """A Senis 3MH6, which streams packets without count or time."""

    def __init__(self, world: World, field: FieldFunction) -> None:
        self._world, self._field = world, field
        self._rates_Hz = {code: rate_Hz for rate_Hz, code in senis_3mh6.RATE_CODES.items()}
        self._rate_Hz, self._range = 10, 4
        self._arrived = b""
        self._is_streaming = False
        self._begin_s, self._n_sent = 0.0, 0

    def take(self, data: bytes) -> bytes:
        """See `Instrument.take`; commands have no terminator, so the first letter tells the length."""
        self._arrived += data
        answers = []
        lengths = {b"S": 1, b"B": 1, b"C": 1, b"K": 3, b"m": 3}
        while self._arrived:
            length = lengths.get(self._arrived[:1], 1)
            if len(self._arrived) < length:
                break
            command, self._arrived = self._arrived[:length], self._arrived[length:]
            answers.append(self._execute(command))
        return b"".join(answers)

    def stream(self) -> bytes:
        """See `Instrument.stream`; all packets of one call hold the same field."""
        if not self._is_streaming:
            return b""
        n_before = self._n_sent
        self._n_sent = int((time.monotonic() - self._begin_s) * self._rate_Hz)
        if self._n_sent == n_before:
            return b""
        now = self._world.snapshot()
        x_T, y_T, z_T = self._field(now)
        packet = Packet((1e3 * x_T, 1e3 * y_T, 1e3 * z_T), _chip_C(now))
        # Real packets carry no count; here the bytes of unknown meaning do, so that tests see a loss.
        counts = range(n_before, self._n_sent)
        return b"".join(encode_packet(packet, count.to_bytes(7, "big")) for count in counts)

    def _execute(self, command: bytes) -> bytes:
        if command == b"S":
            self._is_streaming = False
        elif command == b"B":
            self._is_streaming, self._begin_s, self._n_sent = True, time.monotonic(), 0
        elif command == b"C":
            return b"C\r"
        elif command[:2] == b"mr":
            self._range = int(command[2:])
            return command + b"\r"
        elif command[:1] == b"K":
            code = int(command[1:], 16)
            self._rate_Hz = self._rates_Hz.get(code, self._rate_Hz)
            return bytes([0x4B, code])
        return b""


def _chip_C(now: Snapshot) -> float:
    return now.room_temperature_K + _CHIP_WARMTH_K - ICE_POINT_K


_SAMPLE_S = 50e-6
"""Time for one sample of one axis: 100 samples take 5 ms."""


class SimulatedTHM1176(ScpiInstrument):
    """A THM1176, which measures the axes one after the other."""

    def __init__(self, world: World, field: FieldFunction) -> None:
        self._world, self._field = world, field
        self._range_T, self._n_averaged = 3.0, 1
        self._measured_T = [0.0, 0.0, 0.0]
        self._ended_s = self._start_s = time.monotonic()
        super().__init__(
            {
                "*IDN?": lambda _: "Metrolab Technology SA,THM1176-MF,0001,B:3.0-C:1.0",
                "*STB?": lambda _: str(4 * bool(self._errors)),
                "ABOR": lambda _: None,
                "SENS:FLUX:RANG": self._set_range,
                "SENS:FLUX:RANG:AUTO": lambda _: None,
                "AVER:COUN": self._set_averaging,
                "TRIG:SOUR": lambda _: None,
                "TRIG:COUN": lambda _: None,
                "INIT": lambda _: self._measure(),
                "INIT:CONT": lambda _: None,
                "FETC:TIM?": lambda _: f"0x{round(1e9 * (self._ended_s - self._start_s)):X}",
                **{f"FETC:ARR:{axis}?": partial(self._fetch, index) for index, axis in enumerate("XYZ")},
            },
            "\n",
        )

    def _set_range(self, argument: str) -> None:
        self._range_T = float(argument.upper().removesuffix("T"))

    def _set_averaging(self, argument: str) -> None:
        self._n_averaged = int(argument)

    def _measure(self) -> None:
        for axis in range(3):
            time.sleep(_SAMPLE_S * self._n_averaged)
            self._measured_T[axis] = self._field(self._world.snapshot())[axis]
        self._ended_s = time.monotonic()
        if any(abs(value_T) > self._range_T for value_T in self._measured_T):
            raise ScpiError('205,"Value over range"')

    def _fetch(self, axis: int, _: str) -> str:
        return f"{self._measured_T[axis]:+.8f} T"
