"""`coilcal calibrate`: from a session to a posterior and its report.

The result is printed before the report is drawn, which takes as long as the estimate. A program that reads JSON gets it when all is there.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.command_line import command_of
from estimator.cli.options import (
    PATH,
    REFUSED_SINGLE,
    OutputPath,
    as_described_option,
    ess_option,
    option,
    other_rig_option,
    prediction_options,
    result_options,
    seed_option,
)
from estimator.cli.output import EXIT_NOT_CONVERGED, EXIT_UNUSABLE, CoilcalCommand, show

if TYPE_CHECKING:
    from estimator.calibration.result import Calibration

MOST_WALKERS, MOST_STEPS = 100_000, 1_000_000_000  # more fit into no memory
MOST_LISTED = 50  # amplitudes on the screen


@click.command("calibrate", cls=CoilcalCommand, goes_on=True)
@click.argument("session_path", metavar="SESSION", type=PATH)
@option(
    "--out",
    "Folder for summary.json, posterior.zarr and report.html.",
    OutputPath(is_filled=True),
    required=True,
)
@other_rig_option
@seed_option
@ess_option
@option(
    "--walkers",
    "Walkers of the ensemble; 0 means 32, or two per free parameter if that is more.",
    click.IntRange(0, MOST_WALKERS),
    default=0,
    show_default=False,
)
@option(
    "--max-steps",
    "Stop after this many steps of each walker, converged or not.",
    click.IntRange(1, MOST_STEPS),
    default=20_000,
)
@option(
    "--counts",
    "Treat free loop counts as whole numbers or as real numbers.",
    click.Choice(["integer", "continuous"]),
    default="integer",
)
@as_described_option
@prediction_options("readings", REFUSED_SINGLE)
@result_options
def calibrate_command(
    session_path: Path,
    out: Path,
    rig_path: Path | None,
    ess: float,
    walkers: int,
    max_steps: int,
    counts: str,
    as_json: bool,
    **options: Any,
) -> None:
    """Calibrate the rig of SESSION.

    Run the same command again to continue a calibration that was interrupted.
    """
    from estimator.calibration.calibrate import calibrate
    from estimator.cli.progress import Reporter
    from estimator.inference.ensemble import SamplerSettings
    from estimator.rig_files.read import load_rig
    from estimator.store.session import load_session
    from estimator.store.staging import only_writer

    session = load_session(session_path)
    rig = load_rig(rig_path) if rig_path else None
    settings = SamplerSettings(n_walkers=walkers, target_ess=ess, max_steps=max_steps)
    with only_writer(out):
        with Reporter() as reporter:
            calibration = calibrate(
                session,
                rig,
                out=out,
                settings=settings,
                has_integer_counts=counts == "integer",
                on_stage=reporter.calibration,
                **options,
            )
        summary = dict(calibration.summary())
        if not as_json:
            show(summary, _text(summary), as_json)
        _write_report(calibration, out / "report.html")
    show(summary, f"report: {out / 'report.html'}", as_json)
    if not calibration.summary()["is_converged"]:
        click.echo(
            f"coilcal: sampling did not converge in {calibration.summary()['sampling']['steps']} steps; intervals are provisional "
            "(the same command with more --max-steps continues; measuring what is not determined helps more: coilcal docs choose-priors)",
            err=True,
        )
    if calibration.summary()["quality"]["verdict"] == "unusable":
        sys.exit(EXIT_UNUSABLE)
    if not calibration.summary()["is_converged"]:
        sys.exit(EXIT_NOT_CONVERGED)


def _write_report(calibration: Calibration, path: Path) -> None:
    from estimator.calibration.report import calibration_report  # matplotlib, after the result
    from estimator.store.files import write_text

    write_text(path, calibration_report(calibration, command_of(click.get_current_context())))


def _text(summary: Any) -> str:
    from estimator.calibration.notes import undetermined_lines
    from estimator.calibration.quality import condition
    from estimator.reporting.numbers import percent, probability

    quality = summary["quality"]
    lines = [
        f"{quality['verdict']}: {' '.join(quality['reasons'])}",
        quality["next"],
        *summary.get("notes", ()),
        "",
    ]
    unlisted = _amplitudes(summary)
    lines += _parameter_lines({n: p for n, p in summary["parameters"].items() if n not in unlisted})
    for counts in summary["loop_counts"][:3]:
        lines.append(
            f"{counts['coil']}: {counts['axial']} x {counts['radial']} loops with probability "
            f"{probability(counts['probability'])}{condition(quality)}"
        )
    for role, errors in summary["rmse"].items():
        if errors:
            nominal = summary["rmse_nominal"][role]
            lines.append(
                f"{role}: error {errors['vector_T'] * 1e6:.4g} uT rms of the vector ({percent(errors['relative'], 3)} of the field), "
                f"nominal model {nominal['vector_T'] * 1e6:.4g} uT; coverage of 90 % intervals {percent(summary['coverage90'][role], 1)}"
            )
    lines += [
        f"{name} lies {distance:+.1f} prior standard deviations from its prior's centre: narrow prior or missing physics"
        for name, distance in summary["prior_tension"].items()
        if name not in unlisted
    ]
    lines += [
        f"{coil}: readings determine {told['determined']} of {told['free']} amplitudes"
        + (", which summary.json lists" if unlisted else "")
        for coil, told in summary.get("amplitudes", {}).items()
    ]
    lines += undetermined_lines(summary["undetermined"], summary.get("fitted_besides", ()))
    return "\n".join(lines)


def _parameter_lines(parameters: Mapping[str, Any]) -> list[str]:
    """A table of medians and intervals."""
    from estimator.reporting.numbers import displays

    lines = [f"{'parameter':38} {'median':>12} {'90 % credible interval':>27}  unit"]
    for name, show_as in displays(list(parameters)).items():
        parameter = parameters[name]
        middle, low, high = (
            f"{show_as.factor * value:.6g}" for value in (parameter["median"], *parameter["ci90"])
        )
        lines.append(f"{name:38} {middle:>12} {low:>13} {high:>13}  {show_as.unit or '1'}")
    return lines


def _amplitudes(summary: Any) -> frozenset[str]:
    """Amplitudes of coils without a winding, where they are too many for a table on a screen."""
    coils = tuple(f"{coil}." for coil in summary.get("amplitudes", {}))
    names = [name for name in summary["parameters"] if name.startswith(coils) and name.endswith("_T_per_A")]
    return frozenset(names if coils and len(names) > MOST_LISTED else ())
