"""`coilcal diagnose`: find what the model of a session gets wrong, name the cause, and measure what the extended model gains."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from estimator.cli.options import json_option, other_rig_option, overwrite_option, seed_option
from estimator.cli.output import CoilcalCommand, refuse_existing, show
from estimator.errors import InvalidInput

if TYPE_CHECKING:
    from estimator.diagnosis.result import Diagnosis


@click.command("diagnose", cls=CoilcalCommand)
@click.argument("session_path", metavar="SESSION", type=click.Path(path_type=Path))
@click.option(
    "--validation",
    "validation_path",
    type=click.Path(path_type=Path),
    help="Another session of the same rig, on which the extended model is judged. Without it: the readings marked as validation, or else a "
    "fifth of the readings, in blocks.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder for diagnosis.json, rig_extended.yaml and report.html.",
)
@other_rig_option
@click.option(
    "--posterior/--no-posterior",
    "has_posterior",
    default=True,
    show_default=True,
    help="Sample the posterior of the extended rig into the subfolder calibration, if a cause was found or something remains unexplained.",
)
@seed_option
@overwrite_option
@json_option
def diagnose_command(
    session_path: Path,
    validation_path: Path | None,
    out: Path,
    rig_path: Path | None,
    has_posterior: bool,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Find what the model gets wrong in SESSION.

    The cause is named, the rig is extended by it, and the improvement is measured on unseen readings. The verdict is named,
    indistinguishable, unexplained or nothing_found; each ends with exit code 0.
    """
    from estimator.calibration.report import calibration_report
    from estimator.diagnosis.diagnose import diagnose
    from estimator.diagnosis.report import diagnosis_report
    from estimator.diagnosis.result import CALIBRATION_FOLDER, DIAGNOSIS, REPORT
    from estimator.rig_files.read import load_rig
    from estimator.store.files import write_text
    from estimator.store.session import load_session

    refuse_existing(out, overwrite)
    if out.exists() and not (out / DIAGNOSIS).exists():
        raise InvalidInput(
            f"--overwrite replaces folders that coilcal diagnose has made; received {out}, which has no {DIAGNOSIS}"
        )
    session = load_session(session_path)
    validation = load_session(validation_path) if validation_path else None
    rig = load_rig(rig_path) if rig_path else None
    unfinished = out.with_name(f".{out.name}.unfinished")
    shutil.rmtree(unfinished, ignore_errors=True)
    diagnosis = diagnose(
        session,
        rig,
        validation=validation,
        out=unfinished,
        seed=seed,
        has_posterior=has_posterior,
        on_stage=_show_stage,
    )
    command = f"coilcal diagnose {session_path} --out {out} --seed {seed}"
    write_text(unfinished / REPORT, diagnosis_report(diagnosis, command))
    if diagnosis.posterior is not None:
        write_text(unfinished / CALIBRATION_FOLDER / REPORT, calibration_report(diagnosis.posterior, command))
    shutil.rmtree(out, ignore_errors=True)
    unfinished.rename(out)
    show(diagnosis.to_json(), _text(diagnosis, out), as_json)


def _show_stage(words: str) -> None:
    click.echo(f"coilcal: {words}", err=True)
    sys.stderr.flush()


def _text(diagnosis: Diagnosis, out: Path) -> str:
    from estimator.diagnosis.result import DIAGNOSIS, EXTENDED_RIG, REPORT
    from estimator.diagnosis.verdict import Verdict

    left_open, improvement = diagnosis.left_open, diagnosis.improvement
    lines = [f"verdict: {diagnosis.verdict}"]
    for cause in diagnosis.sized_causes:
        rivals = zip(cause.alternative_names, cause.alternatives, strict=True)
        alternatives = "".join(f", or {name} ({rival.probability:.0%})" for name, rival in rivals)
        lines.append(f"  {cause.name} ({cause.probability:.0%}){alternatives}")
        for name, quantity in cause.quantities.items():
            low, high = quantity.ci90
            lines.append(
                f"    {name:16} {quantity.median:12.5g}  90 %: {low:.5g} to {high:.5g}  {quantity.unit}"
            )
    if diagnosis.findings.stand_ins:
        names = ", ".join(diagnosis.label(cause) for cause in diagnosis.findings.stand_ins)
        lines.append(
            f"  {EXTENDED_RIG} also has {names}: needed here, but something unknown may look like them"
        )
    if diagnosis.verdict is Verdict.UNEXPLAINED:
        remainder = diagnosis.findings.search.steps[-1].discrepancy
        lines.append(
            f"  something is left that no known cause explains: it depends on {remainder.family}, {remainder.rms_sigma:.2g} of the "
            f"noise rms, log evidence {remainder.log_bayes_factor:.3g}"
        )
    if left_open.twins:
        groups = "; ".join(" = ".join(diagnosis.label(cause) for cause in group) for group in left_open.twins)
        lines.append(f"  this session cannot tell apart: {groups}")
    if improvement is not None:
        before, after = improvement.before, improvement.after
        lines.append(
            f"unseen readings: {before.errors.vector_T * 1e6:.4g} -> {after.errors.vector_T * 1e6:.4g} uT rms of the vector; coverage "
            f"of 90 % intervals {before.coverage90:.1%} -> {after.coverage90:.1%}; log predictive density "
            f"{improvement.elpd_difference:+.1f} +- {improvement.elpd_se:.1f}"
        )
    if left_open.next_measurements:
        best = left_open.next_measurements[0]
        lines.append(
            f"  to tell them apart, measure {best.action.words} (expected log evidence {best.expected_log_evidence:.0f})"
        )
    lines.append(f"written: {out / DIAGNOSIS}, {out / EXTENDED_RIG}, {out / REPORT}")
    return "\n".join(lines)
