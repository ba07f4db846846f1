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
        # watchdog_s: 10          # only of an scpi supply with OUTP:PROT:WDOG: off when it hears nothing for so long
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

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

from drivers.device import ClosesItself
from drivers.entries import arm_of, monitor_of, sensor_of, source_of
from drivers.errors import Refused
from drivers.guarded import GuardedSensor, GuardedSource, GuardedThermometer
from drivers.interlock import Interlock, Watch
from drivers.limits_section import limits_of
from drivers.protocols import CurrentSource, Device, FieldSensor, RobotArm, TemperatureMonitor, Thermometer
from drivers.readings import ICE_POINT_K
from drivers.safety import CoilLoad
from drivers.settings import Settings, noting

_TEMPERATURE_S = 3.0


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


def open_devices(section: Mapping[str, Any]) -> DeviceSet:
    """Open all devices of a section; if one cannot be opened, none stays open.

    Args:
        section: Settings of each device, by its name, as above.

    Raises:
        Refused: A setting is missing, unknown or impossible.
        DriverError: A device is not there.
    """
    limits_of(section)
    devices = DeviceSet()
    try:
        for name, mapping in section.items():
            _opener(name, Settings(mapping, f"devices.{name}"))(devices)
    except BaseException:
        devices.close()
        raise
    return devices


def faults_of(section: Mapping[str, Any]) -> list[Refused]:
    """All that is wrong with the settings of a section; no device is touched.

    Args:
        section: Settings of each device, by its name, as above.
    """
    faults: list[Refused] = []
    for name, mapping in section.items():
        with noting(faults):
            settings = Settings(mapping, f"devices.{name}", faults)
            _opener(name, settings)
    if not faults:
        with noting(faults):
            limits_of(section)
    return faults


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


def _opener(name: str, settings: Settings) -> Callable[[DeviceSet], None]:
    """Read the settings of one device; what is returned opens it and adds it to a set."""
    if "sensor" in settings:
        open_sensor = sensor_of(settings)
        has_thermometer = settings.flag("own_temperature")

        def opened(devices: DeviceSet) -> None:
            sensor = open_sensor()
            devices.sensors[name] = GuardedSensor(sensor, devices.interlock, name=name)
            if has_thermometer:
                _add_thermometer(devices, name, sensor, settings)
    elif "supply" in settings:
        open_source = source_of(settings)

        def opened(devices: DeviceSet) -> None:
            def read_temperature_K() -> float:
                """Look the thermometer up on each call: the section may name it after the supply."""
                return devices.thermometers[name].read_temperature_K(timeout_s=_TEMPERATURE_S).value

            devices.sources[name] = open_source(name, devices.interlock, read_temperature_K)
    elif "arm" in settings:
        open_arm = arm_of(settings)

        def opened(devices: DeviceSet) -> None:
            devices.arms[name] = open_arm(name, devices.interlock)
    elif "thermometer" in settings:
        open_monitor = monitor_of(settings)

        def opened(devices: DeviceSet) -> None:
            devices.monitors[name] = monitor = open_monitor()
            for target, thermometer in monitor.thermometers.items():
                _add_thermometer(devices, target, thermometer, settings)
    else:
        raise Refused(
            f"{settings.location} must be a sensor, supply, arm or thermometer; received none of these keys"
        )
    settings.finish()
    return opened


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
