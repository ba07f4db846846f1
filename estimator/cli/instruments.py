"""What the commands that talk to instruments share: the devices of a rig, and faults of their settings with file and line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import DeviceFault, DriverError, Refused
from drivers.limits_section import thermometer_inputs
from drivers.open import DeviceSet, faults_of, open_devices
from estimator.errors import Faults, InvalidInput, in_order
from estimator.rig.rig import Rig
from estimator.rig_files.devices import DEVICES, DeviceSettings, load_devices, read_devices, setting_place
from estimator.rig_files.read import load_rig
from estimator.yaml_section import Section

NAMED = re.compile(r"devices\.(?P<name>[\w-]+)(\.(?P<key>\w+))?")


@dataclass(frozen=True)
class Bench:
    """A rig with the settings of its instruments.

    Attributes:
        rig: Coils, sensors and movers, as the model sees them.
        devices: Settings of each instrument, by the name of the coil, sensor or mover that it serves.
        path: File that holds the settings.
    """

    rig: Rig
    devices: DeviceSettings
    path: Path

    @classmethod
    def load(cls, rig_path: Path, devices_path: Path | None) -> Bench:
        """Read a rig file, and the devices from a file of their own if there is one.

        Raises:
            InvalidInput: Neither file has devices.
        """
        rig = load_rig(rig_path)
        path = devices_path or rig_path
        devices = load_devices(devices_path, rig) if devices_path else rig.devices
        if not devices:
            raise InvalidInput(
                f"the rig must have a section devices, or be given one with --devices; received none ({path})"
            )
        return cls(rig, devices, path)

    def open(self, *names: str) -> DeviceSet:
        """Open the devices of these names and the thermometers that measure them; all devices if no name is given.

        Raises:
            Refused: A setting breaks a rule; the message ends with its file and line.
            DriverError: A device does not answer.
        """
        thermometers = [
            name
            for name, settings in self.devices.items()
            if not set(names).isdisjoint(thermometer_inputs(settings))
        ]
        opened = (*names, *thermometers) if names else tuple(self.devices)
        with self.located():
            return open_devices({name: self.devices[name] for name in opened})

    @contextmanager
    def opened(self) -> Iterator[DeviceSet]:
        """Open all devices, watch coils and arms during the block, and close them after it.

        Raises:
            DeviceFault: A device failed, in the block or while it was closed. The message says which, why, and what is not known to be at
                rest. An interruption that leaves anything not known to be at rest is a fault too: the operator must hear of it.
        """
        devices = self.open()
        interlock = devices.interlock
        try:
            with devices, devices.watch():
                yield devices
        except DriverError as error:
            if interlock.reason is None:
                raise
            rest = "; ".join(interlock.not_at_rest) or "arms and currents were brought to rest"
            raise DeviceFault(f"{interlock.reason}; {rest}") from error
        except (KeyboardInterrupt, SystemExit) as interruption:
            if not interlock.not_at_rest:
                raise
            raise DeviceFault(f"interrupted; {'; '.join(interlock.not_at_rest)}") from interruption

    @contextmanager
    def located(self) -> Iterator[None]:
        """Add file and line to a setting that the drivers refuse."""
        try:
            yield
        except Refused as error:
            setting = NAMED.match(str(error))
            if setting is None:
                raise
            where = setting_place(self.path, setting["name"], setting["key"] or "")
            raise Refused(f"{error} ({where})") from error


def fault_words(error: DriverError, name: str) -> str:
    """One sentence that names the device that failed."""
    text = str(error) or type(error).__name__
    return text if NAMED.match(text) else f"devices.{name}: {text}"


def device_faults(path: Path, devices: DeviceSettings) -> list[InvalidInput]:
    """Faults of the settings that drivers ask for.

    Args:
        path: File that holds them.
        devices: The settings.
    """
    faults = []
    for fault in faults_of(devices):
        named = NAMED.match(str(fault))
        if named is None:
            faults.append(InvalidInput(f"{fault} ({path})"))
        else:
            place = setting_place(path, named["name"], named["key"] or "")
            faults.append(InvalidInput.at(place, str(fault)))
    return faults


def is_devices_file(path: Path) -> bool:
    """Whether a YAML file holds settings of instruments, as `coilcal rig-simulator` writes it, and no plan."""
    try:
        return DEVICES in Section.from_file(path)
    except InvalidInput:
        return False


def devices_and_faults(path: Path, rig: Rig) -> tuple[DeviceSettings, list[InvalidInput]]:
    """Settings in a file of their own, and all that is wrong in it, in the order of its lines."""
    faults = Faults(is_collected=True)
    devices: DeviceSettings = {}
    with faults.noting():
        top = Section.from_file(path, faults)
        devices = read_devices(top.section(DEVICES), rig)
        top.finish()
    return devices, in_order([*faults.noted, *device_faults(path, devices)])
