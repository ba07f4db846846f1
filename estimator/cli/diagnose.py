"""`coilcal diagnose`: what the simulation gets wrong, which cause that has, and what the extension gains."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import click

from estimator.calibration.report import calibration_report
from estimator.calibration.result import write_text
from estimator.cli.options import json_option, other_rig_option, overwrite_option, seed_option
from estimator.cli.output import explain_errors, refuse_existing, show
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.report import diagnosis_report
from estimator.diagnosis.result import CALIBRATION_FOLDER, DIAGNOSIS, EXTENDED_RIG, REPORT
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
    found = diagnose(
        session, rig, validation=validation, out=made, seed=seed, has_posterior=has_posterior, on_stage=_tell
    )
    command = f"coilcal diagnose {session_path} --out {out} --seed {seed}"
    write_text(made / REPORT, diagnosis_report(found, command))
    if found.posterior is not None:
        write_text(made / CALIBRATION_FOLDER / REPORT, calibration_report(found.posterior, command))
    shutil.rmtree(out, ignore_errors=True)
    made.rename(out)
    record = found.record()
    show(record, _text(record, out), as_json)


def _tell(words: str) -> None:
    click.echo(f"coilcal: {words}", err=True, nl=True)
    sys.stderr.flush()


def _text(record: dict[str, Any], out: Path) -> str:
    lines = [f"verdict: {record['verdict']}"]
    for cause in record["causes"]:
        others = "".join(f", or {o['name']} ({o['probability']:.0%})" for o in cause["alternatives"])
        lines.append(f"  {cause['name']} ({cause['probability']:.0%}){others}")
        for key, p in cause["parameters"].items():
            low, high = p["ci90"]
            lines.append(f"    {key:16} {p['median']:12.5g}  90 %: {low:.5g} to {high:.5g}  {p['unit']}")
    if record["stand_ins"]:
        kept = ", ".join(cause["name"] for cause in record["stand_ins"])
        lines.append(
            f"  {EXTENDED_RIG} also has {kept}: needed here, but something unknown may look like them"
        )
    if record["verdict"] == "unexplained":
        left = record["unexplained"]
        lines.append(
            f"  something is left that no known cause explains: it depends on {left['looks_like']}, {left['rms_sigma']:.2g} of the "
            f"noise rms, log evidence {left['log_bayes_factor']:.3g}"
        )
    if record["indistinguishable"]:
        groups = "; ".join(" = ".join(group) for group in record["indistinguishable"])
        lines.append(f"  this session cannot tell apart: {groups}")
    if "gain" in record:
        before, after = record["gain"]["before"], record["gain"]["after"]
        lines.append(
            f"unseen readings: {before['vector_T'] * 1e6:.4g} -> {after['vector_T'] * 1e6:.4g} uT rms of the vector; coverage of 90 % "
            f"intervals {before['coverage90']:.1%} -> {after['coverage90']:.1%}; log predictive density "
            f"{record['elpd_difference']:+.1f} +- {record['elpd_se']:.1f}"
        )
    if record["next_measurement"]:
        best = record["next_measurement"][0]
        lines.append(
            f"  to tell them apart, measure {best['action']} (expected log evidence {best['expected_log_evidence']:.0f})"
        )
    lines.append(f"written: {out / DIAGNOSIS}, {out / EXTENDED_RIG}, {out / REPORT}")
    return "\n".join(lines)
