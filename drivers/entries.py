"""Reads what an entry of the `devices` section says, the whole of it before anything is opened.

Each function takes the settings of one device and returns what opens it, so that `coilcal check` can read without opening
(`faults_of` in `drivers.open`).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from drivers.errors import DriverError, Refused
from drivers.guarded import GuardedArm, GuardedSource
from drivers.hall import lakeshore_460, lakeshore_f71, metrolab_thm1176, senis_3mh6
from drivers.interlock import Interlock
from drivers.limits_section import arm_limits, current_limits
from drivers.protocols import CurrentSource, FieldSensor, RobotArm, TemperatureMonitor
from drivers.safety import CurrentLimits
from drivers.settings import Settings
from drivers.supervised import LONGEST_START_S
from drivers.supplies import korad_ka3005p
from drivers.supplies.commands import SupplyCommands
from drivers.supplies.ramped import RampedSource, longest_off_s
from drivers.supplies.scpi import GENERIC, KEPCO_BOP, ScpiSupply
from drivers.supplies.supervised import SupervisedSource
from drivers.thermometers import lakeshore_224
from drivers.transport.port import Port
from drivers.transport.pumped import PumpedPort
from drivers.transport.serial_port import SerialPort, SerialSettings, is_pseudo_terminal
from drivers.transport.tcp import TcpPort
from drivers.transport.transcript import RecordingPort, ReplayedPort
from drivers.transport.visa import VisaPort

SENSORS = ("lakeshore_f71", "lakeshore_460", "senis_3mh6", "metrolab_thm1176")
SUPPLIES = ("kepco_bop", "korad_ka3005p", "scpi")
THERMOMETERS = ("lakeshore_224",)
ARMS = {model.lower(): model for model in ("UR3", "UR5", "UR10", "UR3e", "UR5e", "UR10e", "UR16e", "UR20")}

_CONNECT_S = 3.0
_WATCHDOGS_S = (4, 3600)
"""Delays of the watchdog of a supply, in seconds: a busy computer asks no more often than once a second for sure."""
_SCPI_SERIAL = SerialSettings(9600)


def sensor_of(settings: Settings) -> Callable[[], FieldSensor]:
    """What opens a magnetometer."""
    kind = settings.choice("sensor", SENSORS)
    if kind == "lakeshore_460":
        range_T = settings.quantity("range", "field")
        _try(settings, lambda: lakeshore_460.choose_range(range_T))
        port = _port(settings, lakeshore_460.SERIAL)
        return lambda: lakeshore_460.LakeShore460(port.open(), range_T=range_T)
    if kind == "metrolab_thm1176":
        range_T = settings.quantity("range", "field")
        _try(settings, lambda: metrolab_thm1176.choose_range_T(range_T))
        n_averaged = settings.whole_number("averaged_samples", 100)
        port = _port(settings, _SCPI_SERIAL)
        return lambda: metrolab_thm1176.MetrolabTHM1176(port.open(), range_T=range_T, n_averaged=n_averaged)
    if kind == "senis_3mh6":
        return _senis(settings)
    has_range = settings.has_quantity("range", "field")
    fixed_range_T = settings.quantity("range", "field") if has_range else None
    n_averaged = settings.whole_number("averaged_samples", 1)
    port = _port(settings, lakeshore_f71.SERIAL, lakeshore_f71.TCP_PORT)
    return lambda: lakeshore_f71.LakeShoreF71(port.open(), range_T=fixed_range_T, n_averaged=n_averaged)


def _senis(settings: Settings) -> Callable[[], FieldSensor]:
    rate_Hz = round(settings.quantity("rate", "frequency"))
    range_number = settings.whole_number("range_number")
    full_scale_T = settings.quantity("full_scale", "field")
    _try(settings, lambda: senis_3mh6.check_stream(rate_Hz, range_number))
    port_settings = _port(settings, senis_3mh6.SERIAL, has_messages=False)

    def opened() -> FieldSensor:
        port = port_settings.open()
        port = port if port_settings.connection == "replay" else PumpedPort(port)
        return senis_3mh6.Senis3MH6(
            port, rate_Hz=rate_Hz, range_number=range_number, full_scale_T=full_scale_T
        )

    return opened


def monitor_of(settings: Settings) -> Callable[[], TemperatureMonitor]:
    """What opens an instrument that only measures temperatures."""
    settings.choice("thermometer", THERMOMETERS)
    inputs = settings.texts("inputs")
    with settings.noting(), settings.of_this():
        lakeshore_224.check_inputs(inputs)
    port = _port(settings, lakeshore_224.SERIAL, lakeshore_224.TCP_PORT)
    return lambda: lakeshore_224.LakeShore224(port.open(), inputs)


def source_of(settings: Settings) -> Callable[[str, Interlock, Callable[[], float]], CurrentSource]:
    """What opens a supply, given its name, the interlock and a function that reads the temperature of its coil in kelvin."""
    kind = settings.choice("supply", SUPPLIES)
    limits = current_limits(settings)
    tolerance_A = settings.quantity("tolerance", "current")
    compliance_V = settings.quantity("compliance", "voltage")
    slew_A_per_s = settings.quantity("ramp", "slew", limits.slew_A_per_s)
    start_s = settings.quantity("longest_start", "time", LONGEST_START_S)
    is_korad = kind == "korad_ka3005p"
    serial = korad_ka3005p.SERIAL if is_korad else _SCPI_SERIAL
    port = _port(settings, serial, has_messages=not is_korad)
    watchdog_s = _watchdog_s(settings) if kind == "scpi" else None
    make_supply = partial(_make_supply, kind, port, limits, compliance_V, tolerance_A, watchdog_s)
    make = partial(_make_source, make_supply, port.comes_back, slew_A_per_s)

    def opened(name: str, interlock: Interlock, read_temperature_K: Callable[[], float]) -> CurrentSource:
        off_s = longest_off_s(max(-limits.lowest_A, limits.highest_A), slew_A_per_s)
        source: CurrentSource = (
            make(threading.Event())
            if port.connection == "replay"
            else SupervisedSource(
                make, name, slew_A_per_s=slew_A_per_s, longest_off_s=off_s, longest_start_s=start_s
            )
        )
        if isinstance(source, SupervisedSource):
            interlock.add_condition(name, source.require_alive)
        try:
            return GuardedSource(
                source,
                limits,
                interlock,
                name=name,
                tolerance_A=tolerance_A,
                read_temperature_K=None if limits.highest_temperature_K is None else read_temperature_K,
            )
        except DriverError:
            source.close()
            raise

    return opened


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


def _make_supply(
    kind: str,
    port: PortSettings,
    limits: CurrentLimits,
    compliance_V: float,
    tolerance_A: float,
    watchdog_s: float | None,
) -> SupplyCommands:
    """Open a supply; runs in its child process, which owns the port."""
    if kind == "korad_ka3005p":
        return korad_ka3005p.KoradKA3005P(port.open(), compliance_V=compliance_V, highest_A=limits.highest_A)
    return ScpiSupply(
        port.open(),
        dialect=KEPCO_BOP if kind == "kepco_bop" else GENERIC,
        lowest_A=limits.lowest_A,
        highest_A=limits.highest_A,
        compliance_V=compliance_V,
        resolution_A=tolerance_A,
        watchdog_s=watchdog_s,
    )


def _make_source(
    make_supply: Callable[[], SupplyCommands],
    comes_back: bool,
    slew_A_per_s: float,
    interrupt: threading.Event,
) -> RampedSource:
    """Make a source; runs in its child process."""
    return RampedSource(
        make_supply(),
        slew_A_per_s=slew_A_per_s,
        interrupt=interrupt,
        reopen=make_supply if comes_back else None,
    )


def arm_of(settings: Settings) -> Callable[[str, Interlock], RobotArm]:
    """What opens a robot arm, given its name and the interlock."""
    model = ARMS[settings.choice("arm", tuple(ARMS))]
    limits = arm_limits(settings)
    joint_limits_rad: Sequence[tuple[float, float]] | None = None
    if settings.has_quantity("joint_low", "angle") or settings.has_quantity("joint_high", "angle"):
        low_rad, high_rad = (settings.quantities(key, "angle", 6) for key in ("joint_low", "joint_high"))
        joint_limits_rad = tuple(zip(low_rad, high_rad, strict=True))
    start_s = settings.quantity("longest_start", "time", LONGEST_START_S)
    connection, address = _connection(settings, ("host", "replay"))
    transcript = Path(settings.text("record")) if "record" in settings else None

    def opened(name: str, interlock: Interlock) -> RobotArm:
        # Imported here: only a rig with an arm needs the compiled ur_rtde.
        from drivers.robots.recorded import RecordingArm, ReplayedArm
        from drivers.robots.universal_robot import JOINT_LIMITS_RAD, UniversalRobot

        if connection == "replay":
            return GuardedArm(ReplayedArm(Path(address)), limits, interlock, name=name)
        allowed_rad = joint_limits_rad or JOINT_LIMITS_RAD
        arm: RobotArm = UniversalRobot(address, model, joint_limits_rad=allowed_rad, longest_start_s=start_s)
        if transcript is not None:
            try:
                arm = RecordingArm(arm, transcript, name=name)
            except OSError:
                arm.close()
                raise
        return GuardedArm(arm, limits, interlock, name=name)

    return opened


def _try(settings: Settings, check: Callable[[], object]) -> None:
    """Let a driver judge settings that could be read."""
    if settings.is_sound:
        with settings.noting(), settings.of_this():
            check()


def _connection(settings: Settings, allowed: Sequence[str]) -> tuple[str, str]:
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


def _port(
    settings: Settings, serial: SerialSettings, tcp_port: int | None = None, *, has_messages: bool = True
) -> PortSettings:
    """Read how a device is connected; `has_messages` allows VISA, which carries messages instead of a stream."""
    allowed = ("serial", "tcp", *(("visa",) if has_messages else ()), "replay")
    connection, address = _connection(settings, allowed)
    baud = settings.whole_number("baud", serial.baud)
    transcript = Path(settings.text("record")) if "record" in settings else None
    port_number = tcp_port if tcp_port is not None and "port" not in settings else None
    if connection == "tcp" and port_number is None:
        port_number = settings.whole_number("port")
    line = SerialSettings(baud, serial.data_bits, serial.parity, serial.has_rts_cts)
    return PortSettings(connection, address, line, port_number, transcript)
