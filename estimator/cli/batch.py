"""`coilcal batch`: calibrate many sessions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from estimator.cli.command_line import command_of
from estimator.cli.options import (
    MOST_PROCESSES,
    PATH,
    OutputPath,
    as_described_option,
    ess_option,
    flag,
    json_option,
    option,
    prediction_options,
    seed_option,
)
from estimator.cli.output import EXIT_BAD_INPUT, CoilcalCommand, needing, show, tell_progress


@click.command("batch", cls=CoilcalCommand, goes_on=True)
@click.argument("sessions", metavar="SESSION...", nargs=-1, required=True, type=PATH)
@option(
    "--out", "Folder for posteriors, tables and overview.html.", OutputPath(is_filled=True), required=True
)
@option(
    "--rig",
    "Rig file to use for all sessions instead of the rig stored in each; needed for tables of readings.",
    PATH,
)
@option(
    "--map columns",
    "How the columns of tables are read, as an import has written it (columns.yaml).",
    PATH,
    metavar="FILE",
)
@option(
    "--hypothesis hypotheses",
    "Hypothesis to fit: plain for the rig as it is, or causes to add to it, such as axis_gain+sensor_offset[probe2]. Repeatable.",
    multiple=True,
    default=("plain",),
    metavar="CAUSES",
)
@flag(
    "--each-coil is_each_coil",
    "Calibrate each coil by itself, from the readings in which it alone carries current.",
)
@option(
    "--posterior",
    "Sample the posterior of the hypotheses with more than 5 % probability, or of none.",
    click.Choice(["leaders", "none"]),
    default="leaders",
)
@as_described_option
@ess_option
@option(
    "--workers",
    "Processes on this computer; by default one per processor.",
    click.IntRange(1, MOST_PROCESSES),
)
@option(
    "--scheduler",
    "Use this Dask scheduler instead of local processes, such as tcp://host:8786.",
    metavar="ADDRESS",
)
@prediction_options("readings", "; refused where it changes a reading by more than a twentieth of the noise")
@seed_option
@json_option
def batch_command(
    sessions: tuple[Path, ...], out: Path, posterior: str, ess: float, as_json: bool, **options: Any
) -> None:
    """Calibrate many sessions in parallel.

    A SESSION may be a table of readings, too, as `coilcal import` reads it; --rig then names its rig. The work is spread over all
    processors or over a cluster. Run the command again to continue or to add sessions.

    Exit code 2 if a session failed; the others are calibrated nevertheless.
    """
    with needing("batch", "coilcal batch"):
        from estimator.batching import batch
        from estimator.batching.page import overview

    from estimator.cli.progress import TimeLeft, left_words
    from estimator.inference.ensemble import SamplerSettings
    from estimator.store.files import write_text

    time_left = TimeLeft()
    result = batch(
        sessions,
        out=out,
        has_posterior=posterior == "leaders",
        settings=SamplerSettings(target_ess=ess),
        tell=lambda done, total, words: tell_progress(
            f"{done} of {total}: {words}{left_words(time_left.seconds(done, total))}"
        ),
        **options,
    )
    result.save_table(out)
    write_text(out / "overview.html", overview(result, command_of(click.get_current_context())))
    summary = {
        "fits": len(result.names),
        "sampled": int(result.table()["is_sampled"].sum()) if result.names else 0,
        "new": result.n_new,
        "failed": result.failed,
        "table": str(out / "summary.csv"),
        "page": str(out / "overview.html"),
    }
    lines = [
        f"{summary['fits']} fits, {summary['sampled']} of them sampled; "
        + (
            f"{result.n_new} fits and posteriors are new"
            if result.n_new
            else "all there before, nothing was left to do"
        ),
        f"table: {summary['table']}",
        f"page: {summary['page']}",
        *result.cautions(),
    ]
    show(summary, "\n".join(lines), as_json)
    for name, fault in result.failed.items():
        click.echo(f"coilcal: {name}: {fault}", err=True)
    if result.failed:
        sys.exit(EXIT_BAD_INPUT)
