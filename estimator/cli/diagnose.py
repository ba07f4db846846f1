"""`coilcal diagnose`: find what the model of a session gets wrong, name the cause, and measure what the extended model gains."""

from __future__ import annotations

import math
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.command_line import command_of
from estimator.cli.interruption import interrupt
from estimator.cli.options import (
    PATH,
    REFUSED_SINGLE,
    OutputPath,
    option,
    other_rig_option,
    prediction_options,
    result_options,
    seed_option,
)
from estimator.cli.output import CoilcalCommand, show
from estimator.diagnosis import effort

if TYPE_CHECKING:
    from estimator.diagnosis.limits import Limits
    from estimator.diagnosis.result import Diagnosis
    from estimator.diagnosis.sizes import SizedCause


@click.command("diagnose", cls=CoilcalCommand, goes_on=True)
@click.argument("session_path", metavar="SESSION", type=PATH)
@option(
    "--validation validation_path",
    "Another session of the same rig, on which the extended model is judged. Without it: the readings marked as validation, or else a "
    "fifth of the readings, in blocks.",
    PATH,
)
@option("--out", "Folder for diagnosis.json, rig_extended.yaml and report.html.", OutputPath(), required=True)
@other_rig_option
@option(
    "--posterior/--no-posterior has_posterior",
    "Sample the posterior of the extended rig into the subfolder calibration, if a cause was found or something remains unexplained.",
    default=True,
)
@option(
    "--corrections/--no-corrections has_corrections",
    "Correct predictions by what is left without a name. Without corrections their intervals are widened by it alone.",
    default=True,
)
@option(
    "--minutes",
    "Time for search and corrections. When it is over, the best so far is reported; the same command goes on from there.",
    click.FloatRange(min=0.0),
    default=math.inf,
    show_default=False,
)
@option(
    "--most-causes",
    "Things that may be wrong at once; 6 by default, and one more for each further sensor and coil.",
    click.IntRange(min=0),
)
@option(
    "--thin most_readings",
    "Readings that causes are searched with, thinned evenly where there are more.",
    click.IntRange(min=20),
)
@seed_option
@prediction_options("readings", REFUSED_SINGLE)
@result_options
def diagnose_command(
    session_path: Path,
    validation_path: Path | None,
    out: Path,
    rig_path: Path | None,
    minutes: float,
    most_causes: int | None,
    most_readings: int | None,
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Find what the model gets wrong in SESSION.

    The cause is named, the rig is extended by it, and the improvement is measured on unseen readings. The verdict is named,
    indistinguishable, partly_explained, unexplained or nothing_found; each ends with exit code 0.

    A diagnosis that was killed, stopped (Ctrl-C, SIGTERM) or ran out of --minutes goes on when the same command is given again.
    """
    from estimator.cli.progress import LINE_EVERY_S, Reporter
    from estimator.diagnosis.diagnose import diagnose
    from estimator.diagnosis.fit_journal import FITS
    from estimator.diagnosis.limits import Limits
    from estimator.diagnosis.result import MADE
    from estimator.rig_files.read import load_rig
    from estimator.store.session import load_session
    from estimator.store.staging import check_output, staged

    was_cut_short = (out / FITS).exists()
    check_output(out, overwrite or was_cut_short, MADE)
    session = load_session(session_path)
    validation = load_session(validation_path) if validation_path else None
    rig = load_rig(rig_path) if rig_path else None
    limits = Limits(most_causes, minutes)
    with (
        Reporter(LINE_EVERY_S, LINE_EVERY_S) as reporter,
        _stopping(limits, reporter.stage),
        staged(out, overwrite or was_cut_short, MADE, goes_on=True) as unfinished,
    ):
        _keep_fits(unfinished, out if was_cut_short else None)
        diagnosis = diagnose(
            session,
            rig,
            validation=validation,
            out=unfinished,
            limits=limits,
            most_readings=most_readings or effort.MOST_READINGS_SEARCHED,
            on_stage=reporter.stage,
            on_progress=reporter.fits,
            **options,
        )
        if not as_json:
            with reporter.aside():
                show(diagnosis.to_json(), _text(diagnosis), as_json)
        # matplotlib is loaded after the result is printed
        from estimator.diagnosis.report import write_reports

        write_reports(diagnosis, unfinished, command_of(click.get_current_context()))
    show(diagnosis.to_json(), _written(out), as_json)


def _keep_fits(unfinished: Path, before: Path | None) -> None:
    """Leave nothing of an interrupted diagnosis but its fits; where it has none, take those of one that was cut short."""
    from estimator.diagnosis.fit_journal import FITS

    unfinished.mkdir(exist_ok=True)
    for path in unfinished.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path.name != FITS:
            path.unlink()
    if before is not None and not (unfinished / FITS).exists():
        shutil.copy(before / FITS, unfinished / FITS)


@contextmanager
def _stopping(limits: Limits, tell: Callable[[str], None]) -> Iterator[None]:
    """The first Ctrl-C or SIGTERM ends the search, and the report of the best so far follows; the second ends the program."""

    def stop(*_: object) -> None:
        if limits.stopped.is_set():
            interrupt()
            return
        limits.stopped.set()
        tell(
            "stopping after the fit at hand; the report of the best so far follows (once more to quit at once)"
        )

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _written(out: Path) -> str:
    from estimator.diagnosis.result import DIAGNOSIS, EXTENDED_RIG, REPORT

    return f"written: {out / DIAGNOSIS}, {out / EXTENDED_RIG}, {out / REPORT}"


def _text(diagnosis: Diagnosis) -> str:
    from estimator.diagnosis.headline import NOT_SURE, headline, not_sampled
    from estimator.diagnosis.result import EXTENDED_RIG
    from estimator.diagnosis.statements.gain import unseen_line
    from estimator.diagnosis.statements.left import evidence
    from estimator.diagnosis.statements.priors import held_back, tension
    from estimator.diagnosis.statements.visible import AT_TYPICAL_SIZE, twins

    lines = [*tension(diagnosis), *headline(diagnosis)]
    lines += [line for cause in diagnosis.sized_causes for line in _cause_lines(cause)]
    lines += held_back(diagnosis)
    lines += not_sampled(diagnosis)
    if stand_ins := diagnosis.findings.stand_ins:
        lines.append(f"{EXTENDED_RIG} also has {', '.join(map(diagnosis.label, stand_ins))}: {NOT_SURE}")
    lines += evidence(diagnosis)
    if (correction := diagnosis.fits.correction) is not None:
        words = correction.words(diagnosis.label)
        lines += [words] if words not in lines else []  # the first box says it where it is what to do
    if diagnosis.left_open.twins:
        lines.append(f"this session cannot tell apart {AT_TYPICAL_SIZE}: {twins(diagnosis)}")
    fits, improvement = diagnosis.fits, diagnosis.improvement
    is_extended = fits.extended.rig.acting != fits.plain.rig.acting
    unseen = [] if improvement is None else [unseen_line(improvement, is_extended=is_extended)]
    return "\n".join([f"verdict: {diagnosis.verdict}", *(f"  {line}" for line in lines), *unseen])


def _cause_lines(cause: SizedCause) -> Iterator[str]:
    from estimator.diagnosis.verdict import UNKNOWN
    from estimator.reporting.numbers import probability

    others = [
        *((name, rival.probability) for name, rival in cause.rivals),
        (UNKNOWN, cause.named.p_not_in_library),
    ]
    alternatives = "".join(f", or {name} ({probability(share)})" for name, share in others)
    yield f"{cause.name} ({probability(cause.probability)}){alternatives}"
    for name, interval in cause.sizes:
        yield f"  {name:16} {interval.words}"
    if cause.difference is not None:
        yield f"  known best: {cause.difference.words}"
