"""`coilcal diagnose`: what the simulation gets wrong, which cause that has, and what the extension gains."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import click

from estimator.calibration.report import calibration_report
from estimator.calibration.result import write_text
from estimator.cli.options import json_option, other_rig_option, overwrite_option, seed_option
from estimator.cli.output import explain_errors, refuse_existing, show
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.report import diagnosis_report
from estimator.diagnosis.result import CALIBRATION_FOLDER, DIAGNOSIS, EXTENDED_RIG, REPORT, Diagnosis
from estimator.diagnosis.verdict import Verdict
from estimator.errors import InvalidInput
from estimator.rig_files.read import load_rig
from estimator.store.session import load_session


@click.command("diagnose")
@click.argument("session_path", metavar="SESSION", type=click.Path(path_type=Path))
@click.option(
    "--validation",
    "validation_path",
    type=click.Path(path_type=Path),
    help="Another session of the rig to judge the gain by; else readings marked as validation, else a fifth in blocks.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help=f"Folder for {DIAGNOSIS}, {EXTENDED_RIG} and {REPORT}.",
)
@other_rig_option
@click.option(
    "--posterior/--no-posterior",
    "has_posterior",
    default=True,
    show_default=True,
    help=f"Sample the extended rig with emcee into {CALIBRATION_FOLDER} below the folder, where a cause was found or something is left "
    "unexplained.",
)
@seed_option
@overwrite_option
@json_option
@explain_errors
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
    """Find what the simulation gets wrong in SESSION, name the cause, extend the rig and measure the gain.

    Every verdict ends with exit code 0: named, indistinguishable, unexplained, nothing_found.
    """
    refuse_existing(out, overwrite)
    if out.exists() and not (out / DIAGNOSIS).exists():
        raise InvalidInput(
            f"--overwrite replaces folders that coilcal diagnose has made; received {out}, which has no {DIAGNOSIS}"
        )
    session = load_session(session_path)
    validation = load_session(validation_path) if validation_path else None
    rig = load_rig(rig_path) if rig_path else None
    made = out.with_name(f".{out.name}.unfinished")
    shutil.rmtree(made, ignore_errors=True)
    diagnosis = diagnose(
        session, rig, validation=validation, out=made, seed=seed, has_posterior=has_posterior, on_stage=_tell
    )
    command = f"coilcal diagnose {session_path} --out {out} --seed {seed}"
    write_text(made / REPORT, diagnosis_report(diagnosis, command))
    if diagnosis.posterior is not None:
        write_text(made / CALIBRATION_FOLDER / REPORT, calibration_report(diagnosis.posterior, command))
    shutil.rmtree(out, ignore_errors=True)
    made.rename(out)
    show(diagnosis.to_json(), _text(diagnosis, out), as_json)


def _tell(words: str) -> None:
    click.echo(f"coilcal: {words}", err=True, nl=True)
    sys.stderr.flush()


def _text(diagnosis: Diagnosis, out: Path) -> str:
    left_open, gain = diagnosis.left_open, diagnosis.gain
    lines = [f"verdict: {diagnosis.verdict}"]
    for cause in diagnosis.sized_causes:
        rivals = zip(cause.alternative_names, cause.alternatives, strict=True)
        others = "".join(f", or {name} ({rival.probability:.0%})" for name, rival in rivals)
        lines.append(f"  {cause.name} ({cause.probability:.0%}){others}")
        for key, p in cause.quantities.items():
            low, high = p.ci90
            lines.append(f"    {key:16} {p.median:12.5g}  90 %: {low:.5g} to {high:.5g}  {p.unit}")
    if diagnosis.found.stand_ins:
        names = ", ".join(diagnosis.label(cause) for cause in diagnosis.found.stand_ins)
        lines.append(
            f"  {EXTENDED_RIG} also has {names}: needed here, but something unknown may look like them"
        )
    if diagnosis.verdict is Verdict.UNEXPLAINED:
        left = diagnosis.found.search.steps[-1].left
        lines.append(
            f"  something is left that no known cause explains: it depends on {left.family}, {left.rms_sigma:.2g} of the "
            f"noise rms, log evidence {left.log_bayes_factor:.3g}"
        )
    if left_open.twins:
        groups = "; ".join(" = ".join(diagnosis.label(cause) for cause in group) for group in left_open.twins)
        lines.append(f"  this session cannot tell apart: {groups}")
    if gain is not None:
        before, after = gain.before, gain.after
        lines.append(
            f"unseen readings: {before.errors.vector_T * 1e6:.4g} -> {after.errors.vector_T * 1e6:.4g} uT rms of the vector; coverage "
            f"of 90 % intervals {before.coverage90:.1%} -> {after.coverage90:.1%}; log predictive density "
            f"{gain.elpd_difference:+.1f} +- {gain.elpd_se:.1f}"
        )
    if left_open.next_measurements:
        best = left_open.next_measurements[0]
        lines.append(
            f"  to tell them apart, measure {best.action.words} (expected log evidence {best.expected_log_evidence:.0f})"
        )
    lines.append(f"written: {out / DIAGNOSIS}, {out / EXTENDED_RIG}, {out / REPORT}")
    return "\n".join(lines)
