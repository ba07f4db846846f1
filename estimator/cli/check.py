"""`coilcal check`: all that is wrong with a rig file and a file that goes with it, then what coilcal understood of them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.form_options import FormOptions, form_options
from estimator.cli.options import PATH, json_option
from estimator.cli.output import EXIT_BAD_INPUT, CoilcalCommand, printable, show
from estimator.errors import Faults, InvalidInput

if TYPE_CHECKING:
    from estimator.readings.flags import Flag
    from estimator.readings.observations import Observations
    from estimator.rig.rig import Rig

MOST_SHOWN = 50  # faults; `--json` has them all
PLANS = (".yaml", ".yml")


@click.command("check", cls=CoilcalCommand, takes_derivatives=False)
@click.argument("rig_path", metavar="RIG", type=PATH)
@click.argument("path", metavar="[FILE]", required=False, type=PATH)
@form_options
@json_option
def check_command(rig_path: Path, path: Path | None, form: FormOptions, as_json: bool) -> None:
    """Say all that is wrong with the rig file RIG, its instruments' settings included, and with FILE.

    FILE is a table of readings in any form that `coilcal import` reads, a plan (.yaml), or a file of instruments (.yaml) as
    `coilcal rig-simulator` writes it. No instrument is opened.

    Where nothing is wrong, say what they hold, and which readings cannot have been measured so by what their digits say: blocks that were
    copied, stretches that were filled in, a sensor that stood still while it was moved, bits that are stuck. Exit code 2 where a file is
    wrong.
    """
    from estimator.cli.instruments import device_faults
    from estimator.cli.understood import rig_lines, rig_record
    from estimator.errors import in_order
    from estimator.rig_files.numbers import Numbers
    from estimator.rig_files.read import rig_and_faults
    from estimator.rig_files.unlikely import unlikely_lengths

    numbers = Numbers()
    rig, faults = rig_and_faults(rig_path, numbers)
    if rig is not None:
        faults = in_order([*faults, *device_faults(rig_path, rig.devices)])
    lines, record = [], {}
    if rig is not None and not faults:
        unlikely = unlikely_lengths(numbers)
        lines = [f"{rig_path}: {rig_lines(rig)[0]}", *rig_lines(rig)[1:], *(f"  {each}" for each in unlikely)]
        record = {"rig": rig_record(rig), "unlikely": unlikely}
    if path is not None and rig is not None:
        further, about, file_faults = _file(path, rig, form, is_rig_right=not faults)
        faults = [*faults, *file_faults]
        lines, record = [*lines, *further], {**record, **about}
    elif path is not None:
        lines.append(f"{path} was not looked at: what it may hold depends on the rig file")
    _tell(faults, lines, record, as_json)
    if faults:
        sys.exit(EXIT_BAD_INPUT)


def _file(
    path: Path, rig: Rig, form: FormOptions, is_rig_right: bool
) -> tuple[list[str], dict[str, Any], list[InvalidInput]]:
    """What a plan or a file of readings holds, as lines and as a record, and its faults."""
    from estimator.cli.instruments import devices_and_faults, is_devices_file
    from estimator.cli.understood import plan_lines, plan_record
    from estimator.readings.plan import plan_and_faults

    if path.suffix in PLANS and is_devices_file(path):
        devices, faults = devices_and_faults(path, rig)
        words = [] if faults else [f"{path}: instruments of {', '.join(devices)}"]
        return words, {} if faults else {"devices": dict(devices)}, faults
    if path.suffix in PLANS:
        plan, faults = plan_and_faults(path, rig)
        if plan is None:
            return [], {}, faults
        first, *rest = plan_lines(plan, rig)
        return [f"{path}: {first}", *rest], {"plan": plan_record(plan, rig)}, faults
    return _readings(path, rig, form, is_rig_right)


def _readings(
    path: Path, rig: Rig, form: FormOptions, is_rig_right: bool
) -> tuple[list[str], dict[str, Any], list[InvalidInput]]:
    """What a file of readings holds, and its faults."""
    from estimator.calibration.notes import notes
    from estimator.cli.import_readings import notes_of
    from estimator.cli.proposal import proposal_lines
    from estimator.cli.understood import readings_lines, readings_record
    from estimator.effects.everywhere import with_everywhere
    from estimator.errors import in_order
    from estimator.readings.digits import flags_of_digits
    from estimator.readings.flags import told
    from estimator.store.importers.forms.understand import understood

    noted, read = Faults(is_collected=True), None
    with noted.noting():
        read = understood(path, rig, form.with_currents(rig, {}), noted)
    if noted.noted or read is None:
        return [], {}, in_order(noted.noted)
    observations, faults, warnings = read.readings.observations, list[InvalidInput](), list[str]()
    flags = flags_of_digits(observations)
    if is_rig_right:
        faults, warnings = _physical_faults(rig, observations, flags, str(path))
    first, *rest = readings_lines(read.table)
    if read.proposal is not None:
        rest = [*proposal_lines(path, read)[1:], "  " + " ".join(read.proposal.remarks)]
    rest += [f"  {note}" for note in notes_of(read)]
    sensors = [sensor.name for sensor in rig.sensors]
    if flags:
        rest.append(f"  {told(flags, sensors)}")
    record = {"readings": readings_record(read.table), "flagged": [flag.to_json(sensors) for flag in flags]}
    if is_rig_right and not faults:
        told_besides = [*warnings, *notes(with_everywhere(rig, observations), observations)]
        rest, record = [*rest, *(f"  {note}" for note in told_besides)], {**record, "notes": told_besides}
        record["warnings"] = warnings
    return [f"{path}: {first}", *rest], record, faults


def _physical_faults(
    rig: Rig, observations: Observations, flags: Sequence[Flag], source: str
) -> tuple[list[InvalidInput], list[str]]:
    """What an import of the readings would refuse: too few, nothing measured, other units than they claim; and what it would warn of."""
    from estimator.model.preflight import check_readings
    from estimator.model.unit_gate import check_units
    from estimator.readings.flags import without_flagged
    from estimator.readings.split import with_validation
    from estimator.store.importers.checked import VALIDATION_SHARE

    faults, warnings = Faults(is_collected=True), list[str]()
    check_readings(rig, observations, source, faults=faults)
    if not faults.noted:
        with faults.noting():
            warnings = check_units(rig, without_flagged(observations, flags), source)
            check_readings(rig, with_validation(observations, VALIDATION_SHARE, 0), source)
    return faults.noted, warnings


def _tell(faults: list[InvalidInput], lines: list[str], record: dict[str, Any], as_json: bool) -> None:
    told = [f"{_where(fault)}{_without_place(fault)}" for fault in faults[:MOST_SHOWN]]
    if len(faults) > MOST_SHOWN:
        told.append(f"and {len(faults) - MOST_SHOWN} more; --json lists them all")
    if faults:
        told.append(f"{len(faults)} {'mistake' if len(faults) == 1 else 'mistakes'}")
    else:
        lines.append(_in_all(record))
    entries = [
        {
            "message": _without_place(fault),
            "file": fault.place.file if fault.place else None,
            "line": fault.place.line if fault.place else None,
            "column": fault.place.column if fault.place else None,
        }
        for fault in faults
    ]
    show({"faults": entries, **record}, "\n".join(map(printable, [*lines, *told])), as_json)


def _in_all(record: dict[str, Any]) -> str:
    """What files without a mistake are like, in a few words."""
    doubt = "are not" if record.get("flagged") else "may not be" if record.get("warnings") else ""
    doubts = [f"the readings {doubt}"] if doubt else []
    doubts += ["lengths of the rig file may not be"] if record.get("unlikely") else []
    return f"the form is right, {' and '.join(doubts)}" if doubts else "no mistake found"


def _where(fault: InvalidInput) -> str:
    place = fault.place
    if place is None:
        return ""
    column = "" if place.column is None else f", column {place.column}"
    return f"{place}{column}: "


def _without_place(fault: InvalidInput) -> str:
    """The message without the place at its end, which is told apart from it."""
    place, message = fault.place, str(fault)
    if place is None:
        return message
    return message.removesuffix(f" ({place})").removesuffix(f" ({place.file})")
