"""Diagnose a session: fit the rig, search for causes, extend the rig by them, validate the extension on unseen readings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import torch

from estimator.devices import device_named, precision_named
from estimator.diagnosis import effort, policy
from estimator.diagnosis.asking import asked_beside_mistakes
from estimator.diagnosis.elsewhere import computed_on
from estimator.diagnosis.extension import extended_rig
from estimator.diagnosis.first_fit import FirstFit
from estimator.diagnosis.fit_journal import FITS, remembering
from estimator.diagnosis.fit_place import FitSetting, fitting_by
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.naming import alternative_fits
from estimator.diagnosis.next_readings.expected_evidence import Proposal, actions, proposals
from estimator.diagnosis.outcome import Outcome
from estimator.diagnosis.outlying import outliers_of
from estimator.diagnosis.posterior import judged_as_handed_out, with_posterior
from estimator.diagnosis.progress import OnProgress, unwatched
from estimator.diagnosis.result import (
    CALIBRATION_FOLDER,
    MADE,
    Diagnosis,
    Findings,
    Fits,
    LeftOpen,
    Question,
    label_of,
)
from estimator.diagnosis.structure.symptoms import Symptoms
from estimator.diagnosis.verdict import NamedCause
from estimator.effects import EFFECTS
from estimator.effects.stages import NoiseEffect
from estimator.errors import InvalidInput
from estimator.model.preflight import check_precision, check_readings
from estimator.readings.observations import Observations
from estimator.readings.split import thinned
from estimator.reporting.numbers import probability
from estimator.rig.rig import Cause, Rig
from estimator.side_by_side import meanwhile, one_thread_for_an_operation
from estimator.store.made import check_folder
from estimator.store.session import Session, check_session

MOST_PROPOSALS = 8  # programmes that are listed for each set


def diagnose(
    session: Session,
    rig: Rig | None = None,
    *,
    validation: Session | None = None,
    out: Path | str | None = None,
    seed: int = 0,
    has_posterior: bool = False,
    has_corrections: bool = True,
    limits: Limits | None = None,
    most_readings: int = effort.MOST_READINGS_SEARCHED,
    device: str = "cpu",
    precision: str = "double",
    on_stage: Callable[[str], None] | None = None,
    on_progress: OnProgress = unwatched,
) -> Diagnosis:
    """Find what the simulation gets wrong, name the cause, extend the rig and validate the extension.

    Readings that cannot have been measured as they were recorded are left out, and the result lists them (`findings.flags`).

    Args:
        session: Readings. Those marked as validation are kept out of the fits; where none is marked, a fifth is, in blocks.
        rig: Another description of the session's rig.
        validation: Another session of the same rig; validates the extension instead. Readings of it that cannot have been measured as they
            were recorded do not count either (`findings.judging_flags`).
        out: Folder for `diagnosis.json` and `rig_extended.yaml`, and for `calibration` where the posterior is sampled. Fits that an
            interrupted diagnosis has left there are not made again.
        seed: Of the split, the thinning, the starts and the sampling.
        has_posterior: Sample the posterior of the extended rig from all readings but those for validation. It needs a coil that carried
            current, and a cause or something unexplained, which widens the posterior.
        has_corrections: Correct what no cause explains. Without it intervals are widened by what is left, as where nothing corrects it.
        limits: When search and corrections end before the evidence does. A diagnosis that was cut short says so; another with the same
            `out` goes on. One that was stopped does not sample.
        most_readings: Readings that causes are searched with, thinned evenly where there are more.
        device: Where fits, columns of causes, evidences and corrections are computed, such as `cuda`, and where sampling predicts
            readings; verdict, validation and reports stay on the processor.
        precision: `double`, or `single` for predictions of fits and of sampling; the last step of every fit, columns and evidences are in
            double precision.
        on_stage: Called with a message at the start of each stage.
        on_progress: Called as the readings are asked, with how far it is.
    Returns: The verdict; `nothing_found`, `indistinguishable`, `partly_explained` and `unexplained` are outcomes, not errors.
    Raises:
        InvalidInput: The readings cannot support a fit.
    """
    tell = on_stage or (lambda words: None)
    check_session(session)
    rig = rig or session.rig
    session.check_rig(rig)
    rig.check_free()
    check_readings(rig, session.observations, session.source, needs_current=False)
    place, dtype = device_named(device), precision_named(precision)
    if dtype is not torch.float64:
        check_precision(rig, session.observations)
    question, folder = Question(rig, session.source, seed), None if out is None else Path(out)
    if folder is not None:
        check_folder(folder.absolute())
        MADE.check_open(folder)
    limits = limits or Limits()

    def judged(first: FirstFit) -> tuple[Diagnosis, Observations]:
        return _judged(question, first, limits, has_corrections, place, tell, on_progress)

    with (
        remembering(folder) as journal,
        fitting_by(FitSetting(journal, (place, dtype))),
        one_thread_for_an_operation(),
    ):
        if journal is not None and len(journal):
            tell(f"continuing: {len(journal)} fits were made before")
        tell("fitting the rig as described")
        first = FirstFit.of(question, session, validation, most_readings)
        with _own_contradictions(first.refusal):
            first = first.without_suspects(tell)
            result, unseen = judged(first)
            if not limits.stopped.is_set() and _is_in_doubt(result) and (flags := first.flags_by(result)):
                tell("searching again without readings that were recorded otherwise than they were measured")
                first = first.without(flags).without_suspects(tell)
                result, unseen = judged(first)
    session = first.measured
    seen = session.observations.calibration
    is_changed = bool(result.fits.final.rig.effects) or result.verdict.leaves_something
    if has_posterior and is_changed and bool((seen.current_A != 0.0).any()) and not limits.stopped.is_set():
        names = [
            f"{result.label(each.cause)} {probability(each.probability)}" for each in result.findings.causes
        ]
        is_sampled = result.left_open.widening is None
        what = "sampling the posterior" if is_sampled else "drawing the parameters"
        tell(f"{', '.join([str(result.verdict), *names])}; {what} of the extended rig")
        inside = None if folder is None else folder / CALIBRATION_FOLDER
        result = with_posterior(result, session, limits, inside, device, precision)
        are_kept_out = validation is not None or len(seen) < len(session.observations)
        if result.posterior is not None and are_kept_out and len(unseen):
            result = judged_as_handed_out(result, result.posterior, unseen)
    correction = result.fits.correction
    is_cut_short = correction is not None and correction.is_cut_short
    if is_cut_short or (limits.stopped.is_set() and result.posterior is None):
        result = _cut_short(result, limits)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        result.save(folder)
        if not result.findings.answer.ended_early:
            (folder / FITS).unlink(missing_ok=True)
    return result


@contextmanager
def _own_contradictions(refusal: InvalidInput | None) -> Iterator[None]:
    """Combinations of causes that no rig can have are faults of the program, for the caller's input has been fitted already.

    Args:
        refusal: Why the geometry as recorded is refused, which a diagnosis may still say of the input; None where it is not.
    """
    try:
        yield
    except InvalidInput as error:
        if refusal is not None:
            raise
        raise RuntimeError(f"a diagnosis contradicted itself: {error}") from error


def _cut_short(result: Diagnosis, limits: Limits) -> Diagnosis:
    """A diagnosis that says that it was stopped, also where that came after its causes were found."""
    answer = result.findings.answer
    words = limits.words if answer.ended_early else f"{limits.words} after its causes were found"
    return replace(result, findings=replace(result.findings, answer=replace(answer, ended_early=words)))


def _is_in_doubt(result: Diagnosis) -> bool:
    """Whether something is unexplained, or explained by scatter alone."""
    is_scatter = any(isinstance(EFFECTS[named.cause.name], NoiseEffect) for named in result.causes)
    return result.verdict.leaves_something or is_scatter


def _judged(
    question: Question,
    first: FirstFit,
    limits: Limits,
    has_corrections: bool,
    place: torch.device,
    tell: Callable[[str], None],
    on_progress: OnProgress,
) -> tuple[Diagnosis, Observations]:
    """The diagnosis from readings to be fitted and others to judge the fits, and those that have judged them; they may be none."""
    rig, seed, plain, seen = question.rig, question.seed, first.plain, first.seen
    symptoms = meanwhile(lambda: Symptoms.of(plain, seed))
    said = computed_on(
        place, lambda fit: asked_beside_mistakes(fit, first.refusal, limits, seed, tell, on_progress), plain
    )
    mistakes, answer = said.mistakes, said.said.answer
    outcome = Outcome.of(plain, said.said, mistakes, is_record_wrong=bool(first.flags or mistakes))
    tell("validating on readings not used for fitting")
    if len(seen) > len(plain.observations):
        outcome = outcome.fitted_to(thinned(seen, effort.MOST_READINGS_FITTED, seed))
    unseen, judging_flags = first.judging(outcome.extended)
    if len(unseen):
        unseen = thinned(unseen, effort.MOST_READINGS_FITTED, seed)
    if outcome.verdict.leaves_something and has_corrections:
        outcome = outcome.corrected(unseen, limits, tell)
    elif outcome.verdict.leaves_something:
        outcome = outcome.widened(unseen)
    outcome = outcome.checked_by(unseen, seed)
    named, extended = outcome.named, outcome.extended
    before = symptoms()
    diagnosis = Diagnosis(
        question=question,
        verdict=outcome.verdict,
        findings=Findings(
            answer=answer,
            scatter=outcome.scatter,
            pull=outcome.pull,
            record_mistakes=tuple(mistakes),
            causes=tuple(named),
            stand_ins=tuple(_stand_ins(plain.rig, mistakes, named, extended.rig)),
            flags=first.flags,
            judging_flags=tuple(judging_flags),
            outliers=tuple(
                outliers_of(outcome.after, first.session.observations, outcome.verdict.leaves_something)
            ),
        ),
        fits=Fits(
            plain=plain,
            extended=extended,
            final=outcome.after,
            before=before,
            after=before if extended is plain else Symptoms.of(extended, seed),
            improvement=outcome.improvement,
            correction=outcome.correction,
            budget=outcome.budget,
        ),
        left_open=LeftOpen(
            visible=tuple(said.visible),
            twins=tuple(said.twins),
            next_measurements=tuple(_next_measurements(answer, rig)),
            widening=outcome.widening,
        ),
        extended_rig=extended_rig(rig, outcome.after),
    )
    return diagnosis, unseen


def _stand_ins(
    rig: Rig, mistakes: Sequence[NamedCause], named: Sequence[NamedCause], extended: Rig
) -> list[Cause]:
    """Causes of the extended rig that are not sure enough to be stated."""
    known = {*(cause.cause for cause in named), *(mistake.cause for mistake in mistakes), *rig.effects}
    return [cause for cause in extended.effects if cause not in known]


def _next_measurements(answer: Answer, rig: Rig) -> list[Proposal]:
    """The best few proposals that would tell the possibilities of each stated set apart."""
    best: list[Proposal] = []
    for entry in answer.stated:
        if len(entry.listed) < 2:
            continue
        fits = {label_of(cause, rig): fit for cause, fit in alternative_fits(answer, entry).items()}
        possible = actions(answer.plain.observations, rig)
        clear = [p for p in proposals(fits, possible) if p.expected_log_evidence > policy.CLEAR_LOG_EVIDENCE]
        best += clear[:MOST_PROPOSALS]
    return best
