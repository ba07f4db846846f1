"""`coilcal design`: which readings to take next."""

from __future__ import annotations

from pathlib import Path

import click

from estimator.calibration.result import write_text
from estimator.cli.options import json_option, other_rig_option, overwrite_option
from estimator.cli.output import explain_errors, refuse_existing, show
from estimator.diagnosis.next_readings.design import Design, design
from estimator.reporting.plots.style import displays
from estimator.rig_files.read import load_rig
from estimator.store.session import load_session

MOST_PRINTED = 8


@click.command("design")
@click.argument("session_path", metavar="SESSION", type=click.Path(path_type=Path))
@click.option(
    "--split",
    multiple=True,
    metavar="CAUSE",
    help="A cause that is to be told from the others so named, as CAUSE or CAUSE[PLACE]; give two or more.",
)
@click.option("--shrink", metavar="PARAMETER", help="Or a parameter of the rig whose interval is to shrink.")
@click.option(
    "--readings",
    "n_readings",
    type=click.IntRange(1, 500),
    default=20,
    show_default=True,
    help="How many to propose.",
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="Plan to write (YAML), for coilcal simulate and acquire."
)
@other_rig_option
@overwrite_option
@json_option
@explain_errors
def design_command(
    session_path: Path,
    split: tuple[str, ...],
    shrink: str | None,
    n_readings: int,
    out: Path | None,
    rig_path: Path | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Propose the readings to take after SESSION: to tell causes apart, or to shrink a parameter.

    Stops are chosen among the poses of the session and some currents, one after another. Programmes that need a change of the set-up,
    such as a turned sensor, are listed with what they would bring.
    """
    if out is not None:
        refuse_existing(out, overwrite)
    rig = load_rig(rig_path) if rig_path else None
    found = design(load_session(session_path), split=split, shrink=shrink, n_readings=n_readings, rig=rig)
    if out is not None:
        write_text(out, found.plan)
    result = {
        "goal": found.goal,
        "programmes": [
            {"action": one.action.words, "expected_log_evidence": one.expected_log_evidence}
            for one in found.actions
        ],
        "so_far": found.so_far,
        "reached": list(found.reached),
        "plan": None if out is None else str(out),
    }
    show(result, _text(found, out, shrink), as_json)


def _text(found: Design, out: Path | None, shrink: str | None) -> str:
    lines = [f"goal: {found.goal}"]
    unit = displays([shrink])[shrink] if shrink else None
    what = "standard deviation" if shrink else "expected log evidence (3 is 20 to 1)"

    def in_unit(value: float) -> str:
        return f"{value:.3g}" if unit is None else f"{unit.factor * value:.3g} {unit.unit}".rstrip()

    lines.append(f"{what} of the readings so far: {in_unit(found.so_far)}")
    if found.actions:
        lines.append("a programme of readings would add:")
        lines += [
            f"  {one.expected_log_evidence:8.1f}  {one.action.words}" for one in found.actions[:MOST_PRINTED]
        ]
    lines.append(f"with the {len(found.reached)} chosen stops added: {in_unit(found.reached[-1])}")
    lines.append(f"plan: {out}" if out else "give --out to write them as a plan")
    return "\n".join(lines)
