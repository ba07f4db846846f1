"""`coilcal calibrate`: the main job."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from estimator.calibration.calibrate import calibrate
from estimator.calibration.report import calibration_report
from estimator.calibration.result import write_text
from estimator.cli.options import ess_option, json_option, other_rig_option, overwrite_option, seed_option
from estimator.cli.output import EXIT_NOT_CONVERGED, StageReporter, explain_errors, show
from estimator.inference.ensemble import SamplerSettings
from estimator.rig_files.read import load_rig
from estimator.store.session import load_session


@click.command("calibrate")
@click.argument("session_path", metavar="SESSION", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder for summary.json, posterior.zarr, report.html.",
)
@other_rig_option
@seed_option
@ess_option
@click.option(
    "--walkers", type=click.IntRange(min=0), default=0, help="0 stands for 32, or two per free parameter."
)
@click.option("--max-steps", type=click.IntRange(min=1), default=20_000, show_default=True)
@click.option(
    "--counts",
    type=click.Choice(["integer", "continuous"]),
    default="integer",
    show_default=True,
    help="Free loop counts.",
)
@overwrite_option
@json_option
@explain_errors
def calibrate_command(
    session_path: Path,
    out: Path,
    rig_path: Path | None,
    seed: int,
    ess: float,
    walkers: int,
    max_steps: int,
    counts: str,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Calibrate the rig of SESSION; run it again to continue a calibration that was interrupted."""
    session = load_session(session_path)
    rig = load_rig(rig_path) if rig_path else None
    settings = SamplerSettings(n_walkers=walkers, target_ess=ess, max_steps=max_steps)
    with StageReporter() as reporter:
        calibration = calibrate(
            session,
            rig,
            out=out,
            overwrite=overwrite,
            seed=seed,
            settings=settings,
            has_integer_counts=counts == "integer",
            on_stage=reporter,
        )
    command = f"coilcal calibrate {session_path} --out {out} --seed {seed}"
    write_text(out / "report.html", calibration_report(calibration, command))
    show(dict(calibration.summary()), _text(calibration.summary(), out), as_json)
    if not calibration.summary()["is_converged"]:
        click.echo(
            f"coilcal: sampling did not converge in {calibration.summary()['sampling']['steps']} steps; intervals are provisional "
            "(the same command with more --max-steps continues)",
            err=True,
        )
        sys.exit(EXIT_NOT_CONVERGED)


def _text(summary: Any, out: Path) -> str:
    lines = [f"{'parameter':38} {'median':>12} {'90 % credible interval':>27}  unit"]
    for name, p in summary["parameters"].items():
        low, high = p["ci90"]
        lines.append(f"{name:38} {p['median']:12.6g} {low:13.6g} {high:13.6g}  {p['unit']}")
    for entry in summary["loop_counts"][:3]:
        lines.append(
            f"{entry['coil']}: {entry['axial']} x {entry['radial']} loops with probability {entry['probability']:.3f}"
        )
    for role, metrics in summary["rmse"].items():
        if metrics:
            nominal = summary["rmse_nominal"][role]
            lines.append(
                f"{role}: error {metrics['vector_T'] * 1e6:.4g} uT rms of the vector ({metrics['relative']:.3%} of the field), "
                f"nominal model {nominal['vector_T'] * 1e6:.4g} uT; coverage of 90 % intervals {summary['coverage90'][role]:.1%}"
            )
    lines += [
        f"{name} lies {distance:+.1f} prior standard deviations from its prior's centre: narrow prior or missing physics"
        for name, distance in summary["prior_tension"].items()
    ]
    lines += [f"not determined by the data: {d['words']}" for d in summary["undetermined"]]
    lines.append(f"report: {out / 'report.html'}")
    return "\n".join(lines)
