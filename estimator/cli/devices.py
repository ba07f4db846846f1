"""`coilcal devices`: the instruments of a rig."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from drivers.errors import DriverError
from drivers.interlock import sigterm_as_exception
from drivers.open import check_device
from estimator.cli.instruments import Bench, devices_option, fault_of
from estimator.cli.options import json_option
from estimator.cli.output import EXIT_DEVICE, explain_errors, show
from estimator.rig_files.devices import KINDS, THERMOMETER


@dataclass(frozen=True)
class Checked:
    """What one device said: itself and a value, or else a fault."""

    device: str
    kind: str
    identity: str | None = None
    value: str | None = None
    fault: str | None = None


@click.group("devices")
def devices_group() -> None:
    """The instruments of a rig, as the section `devices` of its file names them."""


@devices_group.command("check")
@click.argument("rig_path", metavar="RIG", type=click.Path(path_type=Path))
@devices_option
@click.option(
    "--timeout",
    "timeout_s",
    type=click.FloatRange(min=0.1),
    default=5.0,
    show_default=True,
    help="Time for an answer.",
)
@json_option
@explain_errors
def check_command(rig_path: Path, devices_path: Path | None, timeout_s: float, as_json: bool) -> None:
    """Open each device of RIG, identify it and read one value; nothing moves, no current changes, a supply that is on stays on.

    Exit code 5 where a device fails.
    """
    bench = Bench.load(rig_path, devices_path)
    with sigterm_as_exception():
        report = [_checked(bench, name, timeout_s) for name in bench.devices]
    show({"devices": [asdict(one) for one in report]}, _table(report), as_json)
    faults = [one.fault for one in report if one.fault is not None]
    for fault in faults:
        click.echo(f"coilcal: {fault}", err=True)
    if faults:
        sys.exit(EXIT_DEVICE)


def _checked(bench: Bench, name: str, timeout_s: float) -> Checked:
    """Each device alone, so that one that is missing does not keep the others from answering."""
    kind = next(str(bench.devices[name][key]) for key in (*KINDS, THERMOMETER) if key in bench.devices[name])
    try:
        with bench.open(name) as opened:
            return Checked(name, kind, *check_device(opened.devices[name], timeout_s=timeout_s))
    except DriverError as error:
        return Checked(name, kind, fault=fault_of(error, name))


def _table(report: list[Checked]) -> str:
    rows = [("device", "kind", "value", "identity")]
    rows += [(one.device, one.kind, one.value or "FAULT", one.identity or "") for one in report]
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    return "\n".join(
        "  ".join(
            [*(cell.ljust(width) for cell, width in zip(row[:3], widths, strict=True)), row[3]]
        ).rstrip()
        for row in rows
    )
