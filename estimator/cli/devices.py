"""`coilcal devices`: the instruments of a rig."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from drivers.errors import DriverError
from estimator.cli.options import PATH, devices_option, json_option, option
from estimator.cli.output import EXIT_DEVICE, CoilcalCommand, show
from estimator.glance import aligned

if TYPE_CHECKING:
    from estimator.cli.instruments import Bench


@dataclass(frozen=True)
class DeviceCheck:
    """Answer of a device: its identity and a value, or a fault."""

    device: str
    kind: str
    identity: str | None = None
    value: str | None = None
    fault: str | None = None


@click.group("devices")
def devices_group() -> None:
    """Work with the instruments of a rig.

    The section `devices` of the rig file lists them.
    """


@devices_group.command("check", cls=CoilcalCommand)
@click.argument("rig_path", metavar="RIG", type=PATH)
@devices_option
@option("--timeout timeout_s", "Seconds to wait for an answer.", click.FloatRange(min=0.1), default=5.0)
@json_option
def check_command(rig_path: Path, devices_path: Path | None, timeout_s: float, as_json: bool) -> None:
    """Open each device of RIG, identify it and read one value.

    Nothing moves, no current changes, and a supply that is on stays on.

    Exit code 5 if a device fails.
    """
    from drivers.interlock import sigterm_as_exception
    from estimator.cli.instruments import Bench

    bench = Bench.load(rig_path, devices_path)
    with sigterm_as_exception():
        checks = [_check(bench, name, timeout_s) for name in bench.devices]
    show({"devices": [asdict(check) for check in checks]}, _table(checks), as_json)
    faults = [check.fault for check in checks if check.fault is not None]
    for fault in faults:
        click.echo(f"coilcal: {fault}", err=True)
    if faults:
        sys.exit(EXIT_DEVICE)


def _check(bench: Bench, name: str, timeout_s: float) -> DeviceCheck:
    """Open and check one device alone: a missing device does not keep the others from answering."""
    from drivers.open import check_device
    from estimator.cli.instruments import fault_words
    from estimator.rig_files.devices import KINDS, THERMOMETER

    kind = next(str(bench.devices[name][key]) for key in (*KINDS, THERMOMETER) if key in bench.devices[name])
    try:
        with bench.open(name) as opened:
            return DeviceCheck(name, kind, *check_device(opened.devices[name], timeout_s=timeout_s))
    except DriverError as error:
        return DeviceCheck(name, kind, fault=fault_words(error, name))


def _table(checks: list[DeviceCheck]) -> str:
    rows = [("device", "kind", "value", "identity")]
    rows += [(check.device, check.kind, check.value or "FAULT", check.identity or "") for check in checks]
    return "\n".join(aligned(rows))
