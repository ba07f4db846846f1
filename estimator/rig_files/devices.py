"""The `devices` section of a rig file: the instrument of each sensor, coil and mover.

It is kept as plain data, since only the command line opens instruments (`drivers.open` says what an entry holds). What the section
must get right for the rig is checked here: a device bears the name of what it serves, and a thermometer says what it feels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from estimator.errors import InvalidInput, Place, closest
from estimator.rig.arms import ARMS
from estimator.rig.bodies import MotionKind, Mover
from estimator.rig.rig import Rig
from estimator.yaml_section import Section

DEVICES = "devices"
KINDS = {"sensor": "sensors", "supply": "coils", "arm": "movers"}
THERMOMETER = "thermometer"
JOINT_ARMS = {kind: str(kind).lower() for kind in MotionKind if str(kind) in ARMS}

DeviceSettings: TypeAlias = Mapping[str, Mapping[str, Any]]
"""Settings of each device, as they stand in the file."""


def read_devices(section: Section, rig: Rig) -> DeviceSettings:
    """Take the section of a rig.

    Args:
        section: Of the file; empty where the rig has no devices.
        rig: Whose sensors, coils and movers they serve.
    Raises:
        InvalidInput: A device serves nothing of the rig, or is of no kind or of two.
    """
    devices = {}
    for name in section:
        with section.faults.noting():
            devices[name] = _device(section, name, rig)
    return devices


def load_devices(path: Path, rig: Rig) -> DeviceSettings:
    """Read the devices of a rig from a file of their own, such as `coilcal rig-simulator` writes."""
    top = Section.from_file(path)
    if DEVICES not in top:
        raise InvalidInput(f"{DEVICES} is missing ({path})")
    devices = read_devices(top.section(DEVICES), rig)
    top.finish()
    return devices


def setting_place(path: Path, name: str, key: str) -> Place:
    r"""Place of a setting of a device; of the device where it has no such setting.

    Examples:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "rig.yaml"
        >>> _ = file.write_text("devices:\n  hall:\n    sensor: lakeshore_f71\n")
        >>> [setting_place(file, "hall", key).line for key in ("sensor", "tcp")]
        [3, 2]
    """
    section = Section.from_file(path).section(DEVICES)
    if name not in section or not section.is_section(name):
        return section.place(name)
    device = section.section(name)
    return device.place(key) if key in device else section.place(name)


def without_devices(text: str) -> str:
    r"""Text of a rig file without its devices, which are no part of what identifies the rig.

    Examples:
        >>> without_devices("name: small\n\ndevices:\n  hall: {sensor: lakeshore_f71}\n")
        'name: small\n'
    """
    span = Section.from_text(text, "rig").span(DEVICES) if DEVICES in text else None
    return text if span is None else (text[: span[0]] + text[span[1] :]).rstrip() + "\n"


def _device(section: Section, name: str, rig: Rig) -> Mapping[str, Any]:
    settings = section.section(name)
    kinds = (*KINDS, THERMOMETER)
    named = [kind for kind in kinds if kind in settings]
    if len(named) != 1:
        section.refuse(
            name, f"must be one of {', '.join(kinds)}, as in 'supply: scpi'", " and ".join(named) or "none"
        )
    kind = named[0]
    if kind == THERMOMETER:
        _check_felt(settings, rig)
        return {key: settings.value(key) for key in settings}
    served: Sequence[Any] = getattr(rig, KINDS[kind])
    names = [body.name for body in served]
    if name not in names:
        rule = f"must bear the name of one of the rig's {KINDS[kind]} ({', '.join(names) or 'it has none'})"
        section.refuse(name, rule, f"{name!r}{closest(name, names)}")
    if kind == "arm":
        _check_arm(settings, rig.mover(name))
    return {key: settings.value(key) for key in settings}


def _check_felt(settings: Section, rig: Rig) -> None:
    names = [body.name for body in (*rig.coils, *rig.sensors)]
    inputs = settings.section("inputs")
    for body in inputs:
        if body not in names:
            rule = f"must be the name of a coil or sensor ({', '.join(names)})"
            inputs.refuse(body, rule, f"{body!r}{closest(body, names)}")


def _check_arm(settings: Section, mover: Mover) -> None:
    arm = JOINT_ARMS.get(mover.motion)
    if arm is not None and settings.value("arm") != arm:
        settings.refuse(
            "arm", f"must be {arm}, as the joints of {mover.name} say", repr(settings.value("arm"))
        )
