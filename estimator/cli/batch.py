"""`coilcal batch`: many sessions at once."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click

from estimator.calibration.result import write_text
from estimator.cli.options import ess_option, json_option, seed_option
from estimator.cli.output import EXIT_BAD_INPUT, explain_errors, show
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings


@click.command("batch")
@click.argument("sessions", metavar="SESSION...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), required=True, help="Folder for results, table and page."
)
@click.option(
    "--rig", type=click.Path(path_type=Path), help="Another description of the rig of all sessions."
)
@click.option(
    "--hypothesis",
    "hypotheses",
    multiple=True,
    default=("plain",),
    show_default=True,
    metavar="CAUSES",
    help="Causes that are free in addition, such as axis_gain+sensor_offset[probe2], or plain; may be given several times.",
)
@click.option(
    "--each-coil",
    is_flag=True,
    help="Calibrate each coil by itself, from readings in which it alone has current.",
)
@click.option(
    "--posterior",
    type=click.Choice(["leaders", "none"]),
    default="leaders",
    show_default=True,
    help="Sample hypotheses with more than 5 % probability.",
)
@ess_option
@click.option(
    "--workers", type=click.IntRange(min=1), help="Processes on this computer; one per processor by default."
)
@click.option(
    "--scheduler", metavar="ADDRESS", help="Dask scheduler to use instead, such as tcp://host:8786."
)
@seed_option
@json_option
@explain_errors
def batch_command(
    sessions: tuple[Path, ...],
    out: Path,
    rig: Path | None,
    hypotheses: tuple[str, ...],
    each_coil: bool,
    posterior: str,
    ess: float,
    workers: int | None,
    scheduler: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Calibrate many sessions on all processors or on a cluster; run it again to go on or to add sessions.

    Exit code 2 if a session failed; all others are calibrated nevertheless.
    """
    try:
        from estimator.batching import batch
        from estimator.batching.page import overview
    except ModuleNotFoundError as error:
        raise InvalidInput(
            f"coilcal batch needs {error.name}: install coilcal with its extra, pip install 'coilcal[batch]'"
        ) from error

    result = batch(
        sessions,
        out=out,
        rig=rig,
        hypotheses=hypotheses,
        is_each_coil=each_coil,
        has_posterior=posterior == "leaders",
        seed=seed,
        settings=SamplerSettings(target_ess=ess),
        workers=workers,
        scheduler=scheduler,
        tell=lambda done, total, words: click.echo(f"{done} of {total}: {words}", err=True),
    )
    result.save_table(out)
    given = {"--out": out, "--rig": rig, "--posterior": posterior, "--ess": f"{ess:g}", "--seed": seed}
    command = ["coilcal", "batch", *map(str, sessions)]
    command += [str(word) for option, value in given.items() if value is not None for word in (option, value)]
    command += [word for name in hypotheses for word in ("--hypothesis", name)]
    command += ["--each-coil"] * each_coil
    write_text(out / "overview.html", overview(result, shlex.join(command)))
    found = {
        "fits": len(result.names),
        "sampled": int(result.table()["is_sampled"].sum()) if result.names else 0,
        "new": result.n_new,
        "failed": result.failed,
        "table": str(out / "summary.csv"),
        "page": str(out / "overview.html"),
    }
    lines = [
        f"{found['fits']} fits, {found['sampled']} of them sampled; "
        + (
            f"{result.n_new} fits and posteriors are new"
            if result.n_new
            else "all there before, nothing was left to do"
        ),
        f"table: {found['table']}",
        f"page: {found['page']}",
    ]
    show(found, "\n".join(lines), as_json)
    for what, why in result.failed.items():
        click.echo(f"coilcal: {what}: {why}", err=True)
    if result.failed:
        sys.exit(EXIT_BAD_INPUT)
