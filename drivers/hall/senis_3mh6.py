r"""Senis 3MH6 teslameter: a binary stream of up to 15000 packets a second over USB serial (3 Mbaud).

Protocol: public Python drivers. `S` stops the stream, `C` asks for calibrated values, `K<code>` sets the rate (answer: `K`
and the code as one byte), `mr1` to `mr4` the range, `B` starts packets of 25 bytes: 0x42, big-endian floats Bx, temperature,
By, Bz, seven more bytes, 0x0D. The packets carry neither count nor time, and no command returns a serial number.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from drivers.deadline import Deadline
from drivers.errors import DeviceFault, Refused
from drivers.hall.sensor import HallSensor
from drivers.port_settings import port_of
from drivers.protocols import Reading, ReadingFlag, Vector
from drivers.readings import ICE_POINT_K, ReadingCounter, over_range, quoted
from drivers.settings import Settings
from drivers.transport.port import Port
from drivers.transport.pumped import PumpedPort
from drivers.transport.serial_port import SerialSettings

SERIAL = SerialSettings(3_000_000)

RATE_CODES = {
    10: 0x23, 30: 0x53, 50: 0x63, 60: 0x72, 100: 0x82, 500: 0x92, 1000: 0xA1, 2000: 0xB0, 3750: 0xC0, 7500: 0xD0, 15000: 0xE0,
}  # fmt: skip
"""Codes of `K` by packets per second."""

TESLA_PER_UNIT = 1e-3  # of the packets; the public drivers do not state it, and the display shows millitesla
_PACKET = struct.Struct(">Bffff7sB")
_START, _END = 0x42, 0x0D
_QUIET_S = 0.1


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet of the stream, in the units of the instrument; the temperature is taken to be in degrees Celsius."""

    field: Vector
    temperature: float


def split_packets(stream: bytes) -> tuple[list[Packet], int, bytes]:
    r"""Split a piece of the stream into packets.

    The start byte 0x42 also occurs inside packets. So a packet must end with 0x0D and be followed by another 0x42; in step,
    the last packet need not be followed by anything.

    Args:
        stream: Bytes from anywhere in the stream.

    Returns: Packets, number of bytes outside any packet, and the rest, which may be the start of another packet.

    Examples:
        >>> packet = encode_packet(Packet((1.0, 2.0, -3.0), 25.0))
        >>> split_packets(b"?" + packet + packet[:3])
        ([Packet(field=(1.0, 2.0, -3.0), temperature=25.0)], 1, b'B?\x80')
    """
    packets, n_skipped, start = [], 0, 0
    while len(stream) - start >= _PACKET.size:
        end = start + _PACKET.size
        looks_whole = stream[start] == _START and stream[end - 1] == _END
        if looks_whole and end == len(stream) and n_skipped:
            break  # out of step a moment ago: the next byte will tell
        if looks_whole and stream[end : end + 1] in {b"", b"\x42"}:
            _, x, temperature, y, z, _, _ = _PACKET.unpack_from(stream, start)
            packets.append(Packet((x, y, z), temperature))
            start = end
        else:
            n_skipped += 1
            start += 1
    return packets, n_skipped, stream[start:]


def encode_packet(packet: Packet, seven_more: bytes = bytes(7)) -> bytes:
    """A packet as the instrument sends it; the meaning of its seven other bytes is unknown."""
    x, y, z = packet.field
    return _PACKET.pack(_START, x, packet.temperature, y, z, seven_more, _END)


def decode_rate_answer(answer: bytes, code: int) -> None:
    """Check the answer to `K<code>`.

    Raises:
        DeviceFault: The answer does not confirm the code.

    Examples:
        >>> decode_rate_answer(bytes([0x4B, 0x82]), 0x82)
    """
    if bytes([0x4B, code]) not in answer:
        raise DeviceFault(f"3MH6 must confirm rate code {code:02X}; received {quoted(answer)}")


def check_stream(rate_Hz: int, range_number: int) -> None:
    """Refuse a rate or a range that the instrument has not got.

    Raises:
        Refused: Which one, and those that there are.
    """
    if rate_Hz not in RATE_CODES:
        raise Refused(f"sensor.rate_Hz must be one of {', '.join(map(str, RATE_CODES))}; received {rate_Hz}")
    if range_number not in {1, 2, 3, 4}:
        raise Refused(f"sensor.range_number must be 1, 2, 3 or 4; received {range_number}")


class Senis3MH6(HallSensor):
    """A `FieldSensor` and `Thermometer` that streams; a lost packet shows as bytes that fit into no packet."""

    def __init__(
        self,
        port: Port,
        *,
        rate_Hz: int,
        range_number: int,
        full_scale_T: float,
    ) -> None:
        """Choose its settings.

        Args:
            port: Connection to the instrument.
            rate_Hz: One of `RATE_CODES`.
            range_number: 1 to 4, as in `mr1` to `mr4`.
            full_scale_T: Limit of that range, which depends on the probe; a reading beyond it is flagged.
        """
        check_stream(rate_Hz, range_number)
        super().__init__(port, quieten=b"S")
        self._rate_Hz, self._range_number = rate_Hz, range_number
        self._full_scale_T = full_scale_T
        self._has_streamed = False
        self._rest = b""
        self._last_packet: Packet | None = None
        self._temperatures = ReadingCounter()

    def read_temperature_K(self, *, timeout_s: float) -> Reading[float]:
        """See `Thermometer.read_temperature_K`; from the last packet read, and the first call waits for one."""
        with self._ready(timeout_s) as deadline:
            while self._last_packet is None:
                self._receive(deadline)
            return self._temperatures.reading(
                self._last_packet.temperature + ICE_POINT_K, host_monotonic_s=self._channel.arrived_s
            )

    def close(self) -> None:
        """See `Device.close`; ends the stream, which would fill the buffers of the port unread."""
        deadline = Deadline.after(0.5)
        try:
            if self._is_set_up:
                self._forget_set_up()
                with self._channel.exchange(deadline):
                    self._channel.send(b"S", deadline)
        finally:
            self._channel.close()

    def _identity(self, deadline: Deadline) -> str:
        """Model and settings; the instrument confirms no more than these, and only while it does not stream."""
        self._forget_set_up()
        self._choose_range_and_rate(deadline)
        return f"Senis, 3MH6, range {self._range_number}, {self._rate_Hz} Hz"

    def _set_up(self, deadline: Deadline) -> None:
        """Begin the stream; packets since the end of an earlier stream are lost."""
        self._choose_range_and_rate(deadline)
        self._channel.send(b"B", deadline)
        if self._has_streamed:
            self._counter.note_loss()
        self._has_streamed, self._rest = True, b""

    def _choose_range_and_rate(self, deadline: Deadline) -> None:
        code = RATE_CODES[self._rate_Hz]
        self._channel.send(b"S", deadline)
        for command in (b"C", b"mr%d" % self._range_number):
            self._channel.send(command, deadline)
            self._channel.read_until_silent(_QUIET_S, deadline)
        self._channel.send(b"K%02X" % code, deadline)
        decode_rate_answer(self._channel.read_until_silent(_QUIET_S, deadline), code)

    def _read_fresh(self, deadline: Deadline) -> Reading[Vector]:
        _, _, self._rest = split_packets(self._rest + self._channel.take_arrived(deadline))
        n_passed = 0
        while True:
            for packet in self._receive(deadline):
                n_passed += 1
                if n_passed > 1:  # the first packet was begun before the call
                    return self._reading(packet, self._channel.arrived_s)

    def _read_new(self, deadline: Deadline) -> list[Reading[Vector]]:
        readings: list[Reading[Vector]] = []
        while not readings or (self._channel.has_arrived() and not deadline.is_over):
            # Each piece of the stream gets its own arrival time.
            packets = self._receive(deadline)
            readings += [self._reading(packet, self._channel.arrived_s) for packet in packets]
        return readings

    def _receive(self, deadline: Deadline) -> list[Packet]:
        packets, n_skipped, self._rest = split_packets(self._rest + self._channel.read_some(deadline))
        if n_skipped:
            self._counter.note_loss()
        if packets:
            self._last_packet = packets[-1]
        return packets

    def _reading(self, packet: Packet, arrived_s: float) -> Reading[Vector]:
        x_T, y_T, z_T = (TESLA_PER_UNIT * value for value in packet.field)
        field_T = (x_T, y_T, z_T)
        is_beyond = any(abs(value_T) > self._full_scale_T for value_T in field_T)
        flags = ReadingFlag.OVER_RANGE if is_beyond else over_range(field_T)
        return self._counter.reading(field_T, flags, host_monotonic_s=arrived_s)


def opener(settings: Settings) -> Callable[[], Senis3MH6]:
    """What opens it, by its settings in a rig file."""
    rate_Hz = round(settings.quantity("rate", "frequency"))
    range_number = settings.whole_number("range_number")
    full_scale_T = settings.quantity("full_scale", "field")
    settings.judged_by(lambda: check_stream(rate_Hz, range_number))
    line = port_of(settings, SERIAL, has_messages=False)

    def opened() -> Senis3MH6:
        port = line.open()
        port = port if line.connection == "replay" else PumpedPort(port)
        return Senis3MH6(port, rate_Hz=rate_Hz, range_number=range_number, full_scale_T=full_scale_T)

    return opened
