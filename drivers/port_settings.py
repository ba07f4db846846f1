"""How a device is connected, as its settings in a rig file say: serial line, TCP, VISA or a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import Refused
from drivers.settings import Settings
from drivers.transport.port import Port
from drivers.transport.serial_port import SerialPort, SerialSettings, is_pseudo_terminal
from drivers.transport.tcp import TcpPort
from drivers.transport.transcript import RecordingPort, ReplayedPort
from drivers.transport.visa import VisaPort

SCPI_SERIAL = SerialSettings(9600)
_CONNECT_S = 3.0


@dataclass(frozen=True, slots=True)
class PortSettings:
    """How a device is connected; picklable, for a supply's child process opens its own port.

    Attributes:
        connection: Key that says how: `serial`, `tcp`, `visa` or `replay`.
        address: Value of that key.
        line: Settings of a serial line.
        tcp_port: Number of a TCP port; None for other connections.
        transcript: File to record to; None if nothing is recorded.
    """

    connection: str
    address: str
    line: SerialSettings
    tcp_port: int | None
    transcript: Path | None

    @property
    def comes_back(self) -> bool:
        """Whether the address leads to the same device after its connection was lost; a pseudo-terminal may have become another one."""
        if self.connection == "serial":
            return not is_pseudo_terminal(self.address)
        return self.connection != "replay"

    def open(self) -> Port:
        """Open the port.

        Raises:
            DeviceFault: It is not there, not permitted, or another process has it.
        """
        if self.connection == "replay":
            return ReplayedPort.from_file(Path(self.address))
        port: Port
        if self.connection == "serial":
            port = SerialPort(self.address, self.line)
        elif self.connection == "visa":
            port = VisaPort(self.address)
        else:
            assert self.tcp_port is not None
            port = TcpPort(self.address, self.tcp_port, timeout_s=_CONNECT_S)
        return port if self.transcript is None else RecordingPort(port, self.transcript)


def port_of(
    settings: Settings, serial: SerialSettings, tcp_port: int | None = None, *, has_messages: bool = True
) -> PortSettings:
    """Read how a device is connected; `has_messages` allows VISA, which carries messages instead of a stream."""
    allowed = ("serial", "tcp", *(("visa",) if has_messages else ()), "replay")
    connection, address = connection_of(settings, allowed)
    baud = settings.whole_number("baud", serial.baud)
    transcript = Path(settings.text("record")) if "record" in settings else None
    port_number = tcp_port if tcp_port is not None and "port" not in settings else None
    if connection == "tcp" and port_number is None:
        port_number = settings.whole_number("port")
    line = SerialSettings(baud, serial.data_bits, serial.parity, serial.has_rts_cts)
    return PortSettings(connection, address, line, port_number, transcript)


def connection_of(settings: Settings, allowed: Sequence[str]) -> tuple[str, str]:
    """The key that says how a device is connected, and its address; exactly one must be given."""
    given = [key for key in allowed if key in settings]
    with settings.noting():
        if len(given) != 1:
            raise Refused(
                f"{settings.location} must have one of {', '.join(allowed[:-1])} and {allowed[-1]}; "
                f"received {' and '.join(given) or 'none'}"
            )
    addresses = [settings.text(key) for key in given] or [""]
    return (given or [allowed[0]])[0], addresses[0]
