"""What is wrong with settings of instruments, with file and line; nothing is opened."""

from __future__ import annotations

from pathlib import Path

from drivers.open import faults_of
from estimator.cli.instruments import NAMED
from estimator.errors import Faults, InvalidInput, in_order
from estimator.rig.rig import Rig
from estimator.rig_files.devices import DEVICES, DeviceSettings, read_devices, setting_place
from estimator.yaml_section import Section


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
