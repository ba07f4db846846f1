"""The heart: what the simulation gets wrong in a session, which cause that has, the rig extended by it, and what is gained."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from estimator.diagnosis import policy
from estimator.diagnosis.extension import extended_rig
from estimator.diagnosis.fitting import fit_rig
from estimator.diagnosis.gain import gain
from estimator.diagnosis.hypotheses.record_mistakes import Fault, without_faults
from estimator.diagnosis.hypotheses.search import Search, search
from estimator.diagnosis.hypotheses.step import leaves_structure
from estimator.diagnosis.next_readings.expected_evidence import Proposal, actions, proposals
from estimator.diagnosis.next_readings.resolution import indistinguishable, smallest_visible
from estimator.diagnosis.posterior import extended_posterior
from estimator.diagnosis.result import (
    CALIBRATION_FOLDER,
    Diagnosis,
    Fits,
    Found,
    LeftOpen,
    Question,
    label_of,
)
from estimator.diagnosis.structure.symptoms import Symptoms
from estimator.diagnosis.verdict import (
    NamedCause,
    Verdict,
    beside_discrepancy,
    extended_fit,
    named_causes,
    stand_ins,
    verdict_of,
)
from estimator.diagnosis.widening import Widening
from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.model.preflight import check_readings
from estimator.readings.observations import Observations
from estimator.readings.split import block_split, thinned
from estimator.rig.rig import Rig
from estimator.store.session import Session


def diagnose(
    session: Session,
    rig: Rig | None = None,
    *,
    validation: Session | None = None,
    out: Path | str | None = None,
    seed: int = 0,
    has_posterior: bool = False,
    most_causes: int = policy.MOST_CAUSES,
    on_stage: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Find what the simulation gets wrong, name the cause, extend the rig and measure the gain.

    Args:
        session: Readings; those marked as validation judge the gain. Where none is marked, a fifth is kept out in blocks.
        rig: Another description of the session's rig.
        validation: Another session of the same rig to judge the gain by.
        out: Folder for `diagnosis.json` and `rig_extended.yaml`, and for `calibration` where the posterior is asked for.
        seed: Of the split, the thinning, the starts and the sampling.
        has_posterior: Sample the extended rig where a cause was found or something remains unexplained, and a coil carried current, with
            all readings but those for validation. What remains unexplained widens it.
        most_causes: Where the search ends though another would earn its place; each further one takes longer.
        on_stage: Told what is going on.
    Returns: The verdict; `nothing_found`, `indistinguishable` and `unexplained` are outcomes, not errors.
    Raises:
        InvalidInput: The readings cannot support a fit.
    """
    tell = on_stage or (lambda words: None)
    rig = rig or session.rig
    session.check_rig(rig)
    if not rig.free:
        raise InvalidInput(f"rig must have at least one free parameter (a prior); rig {rig.name!r} has none")
    check_readings(rig, session.observations, session.source, needs_current=False)
    seen, unseen = _split(session, validation, seed)
    few = thinned(seen, policy.MOST_READINGS_SEARCHED, seed)

    tell("fit of the rig as it is described")
    model = MeasurementModel.build(rig, few)
    plain = fit_rig(rig, few, {}, model.rules, policy.MORE_STARTS)
    tell("mistakes of the record")
    base, faults = without_faults(plain)
    tell("screening and naming of causes")
    found = search(base, tell, most_causes)
    if faults and _is_doubtful(faults, found):
        tell("the mistakes of the record are doubtful: again without undoing them")
        base, faults = plain, []
        found = search(base, tell, most_causes)
    named = named_causes(found)
    verdict = verdict_of(found, named)
    if verdict is Verdict.UNEXPLAINED and named:
        named = beside_discrepancy(found, named)
    extended = extended_fit(found, named)
    if verdict is Verdict.NOTHING_FOUND and faults:
        verdict = Verdict.INDISTINGUISHABLE if any(fault.twins for fault in faults) else Verdict.NAMED
    tell("gain on readings not used for fitting")
    before, after = plain, extended
    if len(seen) > len(few):
        many = thinned(seen, policy.MOST_READINGS_FITTED, seed)
        before, after = (fit_rig(fit.rig, many, fit.values, model.rules) for fit in (plain, extended))
    judged = gain(before, after, thinned(unseen, policy.MOST_READINGS_FITTED, seed)) if len(unseen) else None
    if judged is not None and judged.is_loss:
        verdict = Verdict.UNEXPLAINED  # what was named predicts worse: it stands in for something else
    is_unexplained = verdict is Verdict.UNEXPLAINED
    result = Diagnosis(
        question=Question(rig, session.source, seed),
        verdict=verdict,
        found=Found(
            search=found,
            faults=tuple(faults),
            causes=tuple(named),
            stand_ins=tuple(stand_ins(found, named)),
        ),
        fits=Fits(
            plain=plain,
            extended=extended,
            final=after,
            before=Symptoms.of(plain, seed),
            after=Symptoms.of(extended, seed),
            gain=judged,
        ),
        left_open=LeftOpen(
            visible=tuple(smallest_visible(base, found.pool)),
            twins=tuple(indistinguishable(base, found.pool)),
            next_measurements=tuple(_next_measurements(found, named, rig)),
            widening=Widening.of(extended, after, found.steps[-1].left) if is_unexplained else None,
        ),
        extended_rig=extended_rig(rig, after),
    )
    folder = None if out is None else Path(out)
    is_changed = bool(result.fits.final.rig.effects) or is_unexplained
    if has_posterior and is_changed and bool((seen.current_A != 0.0).any()):
        tell("posterior of the extended rig")
        sampled = extended_posterior(
            session,
            result.extended_rig,
            result.left_open.widening,
            out=None if folder is None else folder / CALIBRATION_FOLDER,
            seed=seed,
        )
        result = replace(result, posterior=sampled)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        result.save(folder)
    return result


def _is_doubtful(faults: Sequence[Fault], found: Search) -> bool:
    """Whether a mistake of the record may only have bent a wrong model towards the readings.

    Either more is left than it explained, or the causes that were found beside it explain the record as well as it stands.
    """
    left, final = found.steps[-1].left, found.final
    if leaves_structure(left) and min(fault.log_bayes_factor for fault in faults) < left.log_bayes_factor:
        return True
    rig = final.rig
    for fault in faults:
        rig = rig.without_cause(fault.cause)
    if not rig.effects:
        return False
    rules = final.posterior.model.rules
    as_recorded = fit_rig(rig, final.observations, rig.nominal_values(), rules, policy.MORE_STARTS)
    return as_recorded.log_evidence > final.log_evidence


def _split(session: Session, validation: Session | None, seed: int) -> tuple[Observations, Observations]:
    observations = session.observations
    if validation is not None:
        return observations.calibration, validation.observations
    if not bool(observations.is_validation.any()):
        observations = observations.with_validation(block_split(observations, policy.VALIDATION_SHARE, seed))
    return observations.calibration, observations.validation


def _next_measurements(found: Search, named: list[NamedCause], rig: Rig) -> list[Proposal]:
    """What would tell the members of each credible set apart, as far as their fits show a difference: the best few for each."""
    best: list[Proposal] = []
    for one in named:
        step = found.step_of(one.cause)
        rivals = {
            label_of(r.cause, rig): r.fit for r in step.credible if r.fit is not None and r.cause is not None
        }
        if len(rivals) > 1:
            possible = actions(next(iter(rivals.values())).observations, rig)
            clear = [
                p for p in proposals(rivals, possible) if p.expected_log_evidence > policy.CLEAR_LOG_EVIDENCE
            ]
            best += clear[: policy.MOST_PROPOSALS]
    return best
