"""What the commands that talk to instruments share: which devices a rig has, and faults of its file with file and line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import click

from drivers.errors import DeviceFault, DriverError, Refused
from drivers.limits_section import thermometer_inputs
from drivers.open import DeviceSet, open_devices
from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.rig_files.devices import DeviceSettings, load_devices, place_of
from estimator.rig_files.read import load_rig

NAMED = re.compile(r"devices\.(?P<name>[\w-]+)(\.(?P<key>\w+))?")

devices_option = click.option(
    "--devices",
    "devices_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Take the devices from this file instead, such as coilcal rig-simulator writes.",
)


@dataclass(frozen=True)
class Bench:
    """A rig with the settings of its instruments.

    Attributes:
        rig: As the model sees it.
        devices: Settings by the name of what they serve.
        path: File that holds them.
    """

    rig: Rig
    devices: DeviceSettings
    path: Path

    @classmethod
    def load(cls, rig_path: Path, devices_path: Path | None) -> Bench:
        """Read both.

        Raises:
            InvalidInput: There are no devices.
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
        """Open the devices of these names, with the thermometers that feel them, or all.

        Raises:
            Refused: A setting breaks a rule; the message ends with its file and line.
            DriverError: A device is not there.
        """
        felt = [
            name for name, one in self.devices.items() if not set(names).isdisjoint(thermometer_inputs(one))
        ]
        chosen = {name: self.devices[name] for name in ((*names, *felt) if names else self.devices)}
        with self.located():
            return open_devices(chosen)

    @contextmanager
    def opened(self) -> Iterator[DeviceSet]:
        """All devices for a block in which coils and arms are watched; closed after it.

        Raises:
            DeviceFault: One failed, in the block or while it was closed: which, why, and what is not known to be at rest. An
                interruption that leaves something so is a fault, too: the operator must hear of it.
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
        """Add file and line to what the drivers refuse in the section."""
        try:
            yield
        except Refused as error:
            found = NAMED.match(str(error))
            if found is None:
                raise
            place = place_of(self.path, found["name"], found["key"] or "")
            raise Refused(f"{error} ({place})") from error


def fault_of(error: DriverError, name: str) -> str:
    """One sentence that says which device failed."""
    text = str(error) or type(error).__name__
    return text if NAMED.match(text) else f"devices.{name}: {text}"
