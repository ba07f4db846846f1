"""Opens the devices of a rig from the `devices` section of its file, each behind the limits given there.

A supply runs in a child process, which switches it off when this process is gone. `record` writes the conversation with an
instrument to a transcript. `replay` uses such a transcript instead of the instrument: the same questions get the same answers
(`ReplayedPort`), which is enough for `coilcal devices check` but not for another measurement. For an arm, calls are recorded instead
of bytes (`drivers.robots.recorded`). As YAML, the section reads

    devices:
      hall: {sensor: lakeshore_f71, tcp: 192.168.0.12, range_mT: 350, averaged_samples: 10}    # or serial: /dev/ttyUSB0
      # sensor: lakeshore_460, serial: /dev/ttyUSB0, range_mT: 30
      # sensor: senis_3mh6, serial: /dev/ttyUSB0, rate_Hz: 1000, range_number: 1, full_scale_mT: 100
      # sensor: metrolab_thm1176, visa: 'USB0::0x1BFA::0x0498::0001::INSTR', range_mT: 100, averaged_samples: 100
      # own_temperature: true    # if its probe has a thermometer (F71, 3MH6): recorded with each reading
      coil1:
        supply: kepco_bop         # or korad_ka3005p, scpi
        serial: /dev/ttyUSB1      # with baud: 9600; or tcp: 192.168.0.13 with port: 5025; or visa: 'GPIB0::6::INSTR'
        compliance_V: 20          # voltage limit
        tolerance_mA: 5           # of set-points read back and of the measured current
        lowest_A: -5              # 0 if not given; from here on, limits of the coil
        highest_A: 5
        slew_A_per_s: 10
        continuous_A: 3           # more is allowed until the coil is as warm as this makes it
        thermal_time_constant_min: 5
        longest_start_s: 60       # optional, also of an arm: time for the start of its process on a busy computer
        highest_temperature_C: 80    # optional; needs a thermometer on this coil, such as `warmth` below
      arm1:
        arm: ur3e                 # or ur3
        host: 192.168.0.10        # or replay: arm1.txt, written by an arm with record: arm1.txt
        workspace_low_mm: [0, -300, 0]    # for the flange, in the frame of the arm's base
        workspace_high_mm: [500, 300, 500]
        highest_speed_mm_per_s: 100
        joint_low_deg: [-180, -180, -150, -180, -180, -360]    # optional, together with joint_high_deg
      warmth: {thermometer: lakeshore_224, tcp: 192.168.0.14, inputs: {coil1: A, hall: C1}}    # input of each coil or sensor
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from drivers.device import ClosesItself
from drivers.errors import DriverError, Refused
from drivers.guarded import GuardedArm, GuardedSensor, GuardedSource, GuardedThermometer
from drivers.hall import lakeshore_460, lakeshore_f71, metrolab_thm1176, senis_3mh6
from drivers.interlock import Interlock
from drivers.limits_section import arm_limits, current_limits, limits_of
from drivers.protocols import CurrentSource, Device, FieldSensor, RobotArm, TemperatureMonitor, Thermometer
from drivers.readings import ICE_POINT_K
from drivers.safety import CoilLoad, CurrentLimits
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
from drivers.transport.serial_port import SerialPort, SerialSettings
from drivers.transport.tcp import TcpPort
from drivers.transport.transcript import RecordingPort, ReplayedPort
from drivers.transport.visa import VisaPort
from drivers.watch import Watch

SENSORS = ("lakeshore_f71", "lakeshore_460", "senis_3mh6", "metrolab_thm1176")
SUPPLIES = ("kepco_bop", "korad_ka3005p", "scpi")
THERMOMETERS = ("lakeshore_224",)
ARMS = {model.lower(): model for model in ("UR3", "UR5", "UR10", "UR3e", "UR5e", "UR10e", "UR16e", "UR20")}

_CONNECT_S = 3.0
_TEMPERATURE_S = 3.0
_SCPI_SERIAL = SerialSettings(9600)


@dataclass
class DeviceSet(ClosesItself):
    """The open devices of a rig, by their names in its file; leaving the `with` block closes all, sources first.

    Attributes:
        sensors: Magnetometers.
        sources: Supplies, one for each coil.
        arms: Robot arms.
        monitors: Instruments that only measure temperatures.
        thermometers: Thermometers of monitors and of sensors with their own, by the coil or sensor that each measures.
        interlock: A fault of one device brings all to rest.
    """

    sensors: dict[str, FieldSensor] = field(default_factory=dict)
    sources: dict[str, CurrentSource] = field(default_factory=dict)
    arms: dict[str, RobotArm] = field(default_factory=dict)
    monitors: dict[str, TemperatureMonitor] = field(default_factory=dict)
    thermometers: dict[str, Thermometer] = field(default_factory=dict)
    interlock: Interlock = field(default_factory=Interlock)

    @property
    def devices(self) -> dict[str, Device]:
        """All devices, by name."""
        return {**self.sources, **self.arms, **self.sensors, **self.monitors}

    def watch(self) -> Watch:
        """A watch that checks safety of the arms, and temperature and duty of the coils, during its `with` block."""
        coils = [source.check_coil for source in self.sources.values() if isinstance(source, GuardedSource)]
        return Watch([self.interlock.check_conditions, *coils])

    def begin_with(self, loads: Mapping[str, CoilLoad]) -> None:
        """Start the guards of the coils from the loads that earlier runs have left, by name of the coil."""
        for name, load in loads.items():
            source = self.sources.get(name)
            if isinstance(source, GuardedSource):
                source.begin_with(load)

    def close(self) -> None:
        """Close all devices, even if one fails.

        Raises:
            DriverError: A device is not known to be at rest; the others are closed nevertheless.
        """
        with ExitStack() as stack:
            for device in reversed(self.devices.values()):
                stack.callback(device.close)


def open_devices(section: Mapping[str, Any], location: str = "devices") -> DeviceSet:
    """Open all devices of a section; if one cannot be opened, none stays open.

    Args:
        section: Settings of each device, by its name, as above.
        location: Key of the section, for messages.

    Raises:
        Refused: A setting is missing, unknown or impossible.
        DriverError: A device is not there.
    """
    limits_of(section, location)
    devices = DeviceSet()
    try:
        for name, mapping in section.items():
            settings = Settings(mapping, f"{location}.{name}")
            _open(name, settings, devices)
            settings.finish()
    except BaseException:
        devices.close()
        raise
    return devices


def check_device(device: Device, *, timeout_s: float = 5.0) -> tuple[str, str]:
    """Identify one device and read one value; nothing moves and no current changes.

    Returns: The identity that the device reports, and the value with its unit.

    Raises:
        DriverError: The device does not answer, or reports a fault.
    """
    return device.identify(timeout_s=timeout_s), _value_text(device, timeout_s)


def _value_text(device: Device, timeout_s: float) -> str:
    if isinstance(device, FieldSensor):
        field_reading = device.read_field_T(timeout_s=timeout_s)
        return f"{', '.join(f'{1e3 * value_T:.4g}' for value_T in field_reading.value)} mT"
    if isinstance(device, CurrentSource):
        return f"{device.read_current_A(timeout_s=timeout_s).value:.4g} A"
    if isinstance(device, RobotArm):
        pose = device.read_pose(timeout_s=timeout_s).value
        return f"{', '.join(f'{1e3 * value_m:.2f}' for value_m in pose.position_m)} mm"
    if isinstance(device, TemperatureMonitor):
        return ", ".join(
            f"{target} {thermometer.read_temperature_K(timeout_s=timeout_s).value - ICE_POINT_K:.1f} C"
            for target, thermometer in device.thermometers.items()
        )
    raise Refused(f"a device must be a sensor, a source, an arm or a thermometer; received {device!r}")


def _open(name: str, settings: Settings, devices: DeviceSet) -> None:
    if "sensor" in settings:
        sensor = _open_sensor(settings)
        devices.sensors[name] = GuardedSensor(sensor, devices.interlock, name=name)
        if settings.flag("own_temperature"):
            _add_thermometer(devices, name, sensor, settings)
    elif "supply" in settings:
        devices.sources[name] = _open_source(name, settings, devices)
    elif "arm" in settings:
        devices.arms[name] = _open_arm(name, settings, devices.interlock)
    elif "thermometer" in settings:
        devices.monitors[name] = monitor = _open_monitor(settings)
        for target, thermometer in monitor.thermometers.items():
            _add_thermometer(devices, target, thermometer, settings)
    else:
        raise Refused(
            f"{settings.location} must be a sensor, supply, arm or thermometer; received none of these keys"
        )


def _add_thermometer(devices: DeviceSet, target: str, thermometer: object, settings: Settings) -> None:
    """Add the thermometer of a coil or sensor (`target`)."""
    if not isinstance(thermometer, Thermometer):
        settings.refuse("own_temperature", "must be left out for a sensor without a thermometer")
    if target in devices.thermometers:
        raise Refused(
            f"{settings.location} must not measure the temperature of {target}, which is measured already"
        )
    name = f"the thermometer of {target}"
    devices.thermometers[target] = GuardedThermometer(thermometer, devices.interlock, name=name)


def _open_monitor(settings: Settings) -> TemperatureMonitor:
    settings.choice("thermometer", THERMOMETERS)
    inputs = settings.texts("inputs")
    port = _port(settings, lakeshore_224.SERIAL, lakeshore_224.TCP_PORT)()
    try:
        return lakeshore_224.LakeShore224(port, inputs)
    except Refused:
        port.close()
        raise


def _open_sensor(settings: Settings) -> FieldSensor:
    kind = settings.choice("sensor", SENSORS)
    if kind == "lakeshore_460":
        range_T = settings.quantity("range", "field")
        return lakeshore_460.LakeShore460(_port(settings, lakeshore_460.SERIAL)(), range_T=range_T)
    if kind == "metrolab_thm1176":
        range_T, n_averaged = (
            settings.quantity("range", "field"),
            settings.whole_number("averaged_samples", 100),
        )
        port = _port(settings, _SCPI_SERIAL)()
        return metrolab_thm1176.MetrolabTHM1176(port, range_T=range_T, n_averaged=n_averaged)
    if kind == "senis_3mh6":
        rate_Hz = round(settings.quantity("rate", "frequency"))
        range_number, full_scale_T = (
            settings.whole_number("range_number"),
            settings.quantity("full_scale", "field"),
        )
        port = _port(settings, senis_3mh6.SERIAL, has_messages=False)()
        port = port if "replay" in settings else PumpedPort(port)
        try:
            return senis_3mh6.Senis3MH6(
                port, rate_Hz=rate_Hz, range_number=range_number, full_scale_T=full_scale_T
            )
        except Refused:
            port.close()
            raise
    has_range = settings.has_quantity("range", "field")
    fixed_range_T = settings.quantity("range", "field") if has_range else None
    n_averaged = settings.whole_number("averaged_samples", 1)
    port = _port(settings, lakeshore_f71.SERIAL, lakeshore_f71.TCP_PORT)()
    return lakeshore_f71.LakeShoreF71(port, range_T=fixed_range_T, n_averaged=n_averaged)


def _open_source(name: str, settings: Settings, devices: DeviceSet) -> CurrentSource:
    kind = settings.choice("supply", SUPPLIES)
    limits = current_limits(settings)
    tolerance_A = settings.quantity("tolerance", "current")
    compliance_V = settings.quantity("compliance", "voltage")
    slew_A_per_s = settings.quantity("ramp", "slew", limits.slew_A_per_s)
    start_s = settings.quantity("longest_start", "time", LONGEST_START_S)
    is_replayed = "replay" in settings
    is_korad = kind == "korad_ka3005p"
    serial = korad_ka3005p.SERIAL if is_korad else _SCPI_SERIAL
    open_port = _port(settings, serial, has_messages=not is_korad)
    make = partial(_make_source, kind, open_port, limits, compliance_V, slew_A_per_s, tolerance_A)
    off_s = longest_off_s(max(-limits.lowest_A, limits.highest_A), slew_A_per_s)
    source: CurrentSource = (
        make(threading.Event())
        if is_replayed
        else SupervisedSource(
            make, name, slew_A_per_s=slew_A_per_s, longest_off_s=off_s, longest_start_s=start_s
        )
    )

    def read_temperature_K() -> float:
        """Look the thermometer up on each call: the section may name it after the supply."""
        return devices.thermometers[name].read_temperature_K(timeout_s=_TEMPERATURE_S).value

    try:
        return GuardedSource(
            source,
            limits,
            devices.interlock,
            name=name,
            tolerance_A=tolerance_A,
            read_temperature_K=None if limits.highest_temperature_K is None else read_temperature_K,
        )
    except DriverError:
        source.close()
        raise


def _make_source(
    kind: str,
    open_port: Callable[[], Port],
    limits: CurrentLimits,
    compliance_V: float,
    slew_A_per_s: float,
    tolerance_A: float,
    interrupt: threading.Event,
) -> RampedSource:
    """Make a source; runs in its child process, which owns the port."""
    supply: SupplyCommands
    if kind == "korad_ka3005p":
        supply = korad_ka3005p.KoradKA3005P(
            open_port(), compliance_V=compliance_V, highest_A=limits.highest_A
        )
    else:
        supply = ScpiSupply(
            open_port(),
            dialect=KEPCO_BOP if kind == "kepco_bop" else GENERIC,
            lowest_A=limits.lowest_A,
            highest_A=limits.highest_A,
            compliance_V=compliance_V,
            resolution_A=tolerance_A,
        )
    return RampedSource(supply, slew_A_per_s=slew_A_per_s, interrupt=interrupt)


def _open_arm(name: str, settings: Settings, interlock: Interlock) -> RobotArm:
    # Imported here: only a rig with an arm needs the compiled ur_rtde.
    from drivers.robots.recorded import RecordingArm, ReplayedArm
    from drivers.robots.universal_robot import JOINT_LIMITS_RAD, UniversalRobot

    model = ARMS[settings.choice("arm", tuple(ARMS))]
    limits = arm_limits(settings)
    joint_limits_rad: Sequence[tuple[float, float]] = JOINT_LIMITS_RAD
    if settings.has_quantity("joint_low", "angle") or settings.has_quantity("joint_high", "angle"):
        low_rad, high_rad = (settings.quantities(key, "angle", 6) for key in ("joint_low", "joint_high"))
        joint_limits_rad = tuple(zip(low_rad, high_rad, strict=True))
    start_s = settings.quantity("longest_start", "time", LONGEST_START_S)
    connection = _connection_key(settings, ("host", "replay"))
    address = settings.text(connection)
    transcript = Path(settings.text("record")) if "record" in settings else None
    if connection == "replay":
        return GuardedArm(ReplayedArm(Path(address)), limits, interlock, name=name)
    arm: RobotArm = UniversalRobot(address, model, joint_limits_rad=joint_limits_rad, longest_start_s=start_s)
    if transcript is not None:
        try:
            arm = RecordingArm(arm, transcript, name=name)
        except OSError:
            arm.close()
            raise
    return GuardedArm(arm, limits, interlock, name=name)


def _connection_key(settings: Settings, allowed: Sequence[str]) -> str:
    """The key that says how a device is connected; exactly one must be given."""
    given = [key for key in allowed if key in settings]
    if len(given) != 1:
        raise Refused(
            f"{settings.location} must have one of {', '.join(allowed[:-1])} and {allowed[-1]}; "
            f"received {' and '.join(given) or 'none'}"
        )
    return given[0]


def _port(
    settings: Settings, serial: SerialSettings, tcp_port: int | None = None, *, has_messages: bool = True
) -> Callable[[], Port]:
    """A function that opens the port of a device; picklable, for a supply's child process opens its own.

    `has_messages` allows VISA, which carries messages instead of a stream.
    """
    connection = _connection_key(settings, ("serial", "tcp", *(("visa",) if has_messages else ()), "replay"))
    address = settings.text(connection)
    baud = settings.whole_number("baud", serial.baud)
    transcript = Path(settings.text("record")) if "record" in settings else None
    port_number = tcp_port if tcp_port is not None and "port" not in settings else None
    if connection == "tcp" and port_number is None:
        port_number = settings.whole_number("port")
    line = SerialSettings(baud, serial.data_bits, serial.parity, serial.has_rts_cts)
    return partial(_open_port, connection, address, line, port_number, transcript)


def _open_port(
    connection: str, address: str, line: SerialSettings, port_number: int | None, transcript: Path | None
) -> Port:
    if connection == "replay":
        return ReplayedPort.from_file(Path(address))
    port: Port
    if connection == "serial":
        port = SerialPort(address, line)
    elif connection == "visa":
        port = VisaPort(address)
    else:
        assert port_number is not None
        port = TcpPort(address, port_number, timeout_s=_CONNECT_S)
    return port if transcript is None else RecordingPort(port, transcript)
