"""Which corrections are taken: the best by its evidence is fitted in full, and must predict blocks of places held out better.

Then the rest is asked again. At the end unseen readings may drop what was taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from estimator.diagnosis import policy
from estimator.diagnosis.corrections.kinds import CorrectionCandidate, kinds_of
from estimator.diagnosis.corrections.result import Correction, Part
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.structure.cross_validation import held_out
from estimator.diagnosis.validation import improvement_of
from estimator.diagnosis.widening import Widening
from estimator.readings.observations import Observations
from estimator.readings.split import pose_blocks
from estimator.reporting.numbers import odds
from estimator.rig.rig import Rig


def best_corrected(
    extended: Fit, searched: Fit, causes: Fit, unseen: Observations, tell: Callable[[str], None]
) -> Correction:
    """The correction of the extended rig, or of that with all causes that were taken where these are worth it; judged by unseen readings.

    Args:
        extended: With the named causes, fitted to the readings of the search.
        searched: With all causes that were taken, named or not, fitted to the same.
        causes: The extended rig, fitted to the readings that count.
        unseen: Readings that no fit has seen; may be empty.
        tell: Called with a message for each correction that is taken.
    """
    best = corrected(extended, tell)
    if searched.rig.effects != extended.rig.effects:
        other = corrected(searched, tell)
        lead = other.fit.log_evidence - best.fit.log_evidence
        if other.is_taken and (lead > policy.LEAST_LOG_EVIDENCE_CORRECTED or not best.is_taken):
            best = other
    if not best.is_taken:
        return best
    polished = _fitted(best.fit.rig, best.fit, policy.FINE_TOLERANCE)
    best = replace(best, fit=polished, final=polished)
    if causes.observations is not polished.observations:
        rules = polished.posterior.model.rules
        best = replace(best, final=fit_rig(polished.rig, causes.observations, polished.values, rules))
    if not len(unseen):
        return best
    widened = Widening(best.final, best.final.covariance).over_blocks(best.fit)
    gain = improvement_of(causes, best.final, unseen, widened.covariance)
    if gain.is_loss or gain.after.errors.vector_T > gain.before.errors.vector_T:
        return replace(best, gain=gain, refusal="unseen readings are predicted worse with what was tried")
    return replace(best, gain=gain)


def corrected(fit: Fit, tell: Callable[[str], None]) -> Correction:
    """Correct a fit by what has clear evidence and predicts blocks of places held out better, the best first; roughly fitted.

    Args:
        fit: With all causes.
        tell: Called with a message for each correction that is taken.
    """
    block = pose_blocks(fit.observations, np.random.default_rng(0))
    kinds = kinds_of(fit)
    limits = {kind.cause.label: kind.limit.words for kind in kinds if kind.limit.words}
    kinds = [kind for kind in kinds if kind.limit.degree >= kind.effect.lowest]
    candidates = [
        CorrectionCandidate.at(kind, fit) for kind in kinds
    ]  # columns hardly change as corrections are taken
    parts = list[Part]()
    while candidates and len(parts) < policy.MOST_CORRECTIONS:
        options = [candidate.best_option(fit) for candidate in candidates]
        order = sorted(range(len(options)), key=lambda i: options[i].log_bayes_factor, reverse=True)
        best = options[order[0]]
        if best.log_bayes_factor <= policy.LEAST_LOG_EVIDENCE_CORRECTED:
            break
        candidates = [candidates[i] for i in order[1 : policy.MOST_ASKED_AGAIN + 1]]
        rig = best.kind.rig(fit, best.start, best.widths)
        after = _fitted(rig, fit, policy.ROUGH_TOLERANCE)
        gain = held_out(fit, after, block)
        log_bayes_factor = after.log_evidence - fit.log_evidence
        if gain.elpd_difference <= 0.0 or log_bayes_factor <= 0.0:
            continue
        label = best.kind.cause.label
        tell(f"correcting by {label} to degree {best.degree} ({odds(log_bayes_factor)} for it)")
        parts.append(Part(best.kind.cause, best.degree, len(best.widths), log_bayes_factor, gain))
        fit = after
    refusal = "" if parts else "no correction has clear evidence and predicts places held out better"
    return Correction(fit, tuple(parts), limits, refusal, fit)


def _fitted(rig: Rig, fit: Fit, tolerance: float) -> Fit:
    rules = fit.posterior.model.rules
    return fit_rig(rig, fit.observations, fit.start_with(rig), rules, tolerance=tolerance)
