"""`coilcal design`: which readings to take next."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.options import PATH, OutputPath, option, other_rig_option, result_options
from estimator.cli.output import CoilcalCommand, show

if TYPE_CHECKING:
    from estimator.diagnosis.next_readings.design import Design

MOST_PRINTED = 8
MOST_STOPS = 500


@click.command("design", cls=CoilcalCommand)
@click.argument("session_path", metavar="SESSION", type=PATH)
@option(
    "--split",
    "Cause to tell apart from the others given, as CAUSE or CAUSE[PLACE]. Give it two or more times.",
    multiple=True,
    metavar="CAUSE",
)
@option(
    "--shrink", "Instead of --split: parameter of the rig whose interval shall shrink.", metavar="PARAMETER"
)
@option(
    "--map correction",
    "Instead of --split: correction, such as coil_harmonics[coil1], that a map shall determine.",
    metavar="CORRECTION",
)
@option("--degree", "With --map: highest degree of its terms.", click.IntRange(1, 5), default=3)
@option("--readings n_readings", "Number of readings to propose.", click.IntRange(1, MOST_STOPS), default=20)
@option("--out", "Plan to write (YAML), for coilcal simulate and coilcal acquire.", OutputPath())
@other_rig_option
@result_options
def design_command(
    session_path: Path, out: Path | None, rig_path: Path | None, overwrite: bool, as_json: bool, **aim: Any
) -> None:
    """Propose which readings to take after SESSION.

    The aim is to tell causes apart (--split), to know a parameter better (--shrink), or to determine a smooth correction (--map). Stops
    are chosen one after another, from the poses of the session at a few currents; those of a map from places that fill the ball about
    all places so far. Programmes that change the set-up, such as a turned sensor, are listed with the log evidence that they are expected
    to add.
    """
    from estimator.cli.progress import COUNTED_EVERY_S, UNTOLD_S, Reporter
    from estimator.diagnosis.next_readings.design import design
    from estimator.rig_files.read import load_rig
    from estimator.store.session import load_session
    from estimator.store.staging import check_output, write_output

    if out is not None:
        check_output(out, overwrite)
    rig = load_rig(rig_path) if rig_path else None
    with Reporter(COUNTED_EVERY_S, UNTOLD_S, UNTOLD_S) as reporter:
        proposal = design(load_session(session_path), rig=rig, on_count=reporter.count, **aim)
    if out is not None:
        write_output(out, proposal.plan, overwrite)
    result = {**proposal.to_json(), "plan": None if out is None else str(out)}
    show(result, _text(proposal, out), as_json)


def _text(proposal: Design, out: Path | None) -> str:
    from estimator.reporting.numbers import odds, size_with_unit

    lines = [f"goal: {proposal.goal}"]
    merit = "standard deviation" if proposal.unit else "expected log evidence"

    def in_unit(value: float) -> str:
        return size_with_unit(value, proposal.unit, 3) if proposal.unit else f"{value:.3g} ({odds(value)})"

    lines.append(f"{merit} of the readings so far: {in_unit(proposal.so_far)}")
    if proposal.actions:
        lines.append("a programme of readings would add:")
        lines += [
            f"  {programme.expected_log_evidence:8.1f}  {programme.action.words}"
            for programme in proposal.actions[:MOST_PRINTED]
        ]
    lines.append(f"with the {len(proposal.reached)} chosen stops added: {in_unit(proposal.reached[-1])}")
    if not proposal.unit:
        lines.append(_when_clear(proposal))
    lines.append(f"plan: {out}" if out else "give --out to write them as a plan")
    return "\n".join(lines)


def _when_clear(proposal: Design) -> str:
    """How many of the stops reach odds of 20 to 1."""
    from estimator.diagnosis.policy import CLEAR_LOG_EVIDENCE

    enough = [
        n for n, value in enumerate((proposal.so_far, *proposal.reached)) if value >= CLEAR_LOG_EVIDENCE
    ]
    if enough:
        return f"stops that reach odds of 20 to 1: {enough[0]}"
    gain = (proposal.reached[-1] - proposal.so_far) / len(proposal.reached)
    more = (CLEAR_LOG_EVIDENCE - proposal.so_far) / gain if gain > 0.0 else float("inf")
    if more > MOST_STOPS:
        return "odds of 20 to 1 are out of reach by such stops; see the programmes"
    return f"odds of 20 to 1 would take about {more:.0f} such stops; give --readings {more:.0f} to see"
