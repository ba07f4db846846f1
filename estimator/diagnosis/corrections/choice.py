"""Which corrections are taken: the best by its evidence in the linear model, if it predicts blocks of places held out better.

Then the rest is asked again. What was taken is fitted in full once. Unseen readings may drop it afterwards.

All kinds are asked for what they tell of the session. Only those are taken that a prediction has, for what stands beside any other in a
fit is not the model that is handed out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from estimator.diagnosis import policy
from estimator.diagnosis.corrections.kinds import CorrectionCandidate, kinds_of
from estimator.diagnosis.corrections.linear_fit import full_fit
from estimator.diagnosis.corrections.result import Correction, Part, extent_of
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.source_structure import is_pile
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.structure.cross_validation import held_out
from estimator.readings.split import pose_blocks
from estimator.reporting.numbers import odds
from estimator.side_by_side import each


def best_corrected(
    extended: Fit, searched: Fit, causes: Fit, tell: Callable[[str], None], limits: Limits
) -> Correction:
    """The correction of the extended rig, or of that with all causes that were taken where these are worth it.

    Args:
        extended: With the named causes, fitted to the readings of the search.
        searched: With all causes that were taken, named or not, and that unseen readings have not refuted, fitted to the same.
        causes: The extended rig, fitted to the readings that count.
        tell: Called with a message for each correction that is taken.
        limits: No further correction is asked when they are over.
    """
    if limits.is_over:
        return Correction(extended, (), {}, limits.words, causes, is_cut_short=True)
    standing_in = [cause for cause in searched.rig.effects if cause not in extended.rig.effects]
    is_piled = is_pile(standing_in, policy.MOST_KINDS)
    corrects_already = is_piled
    first = searched if is_piled else extended  # what the bare rig leaves says nothing of what a pile leaves
    kinds = kinds_of(first)
    if is_piled:
        kinds = [kind.with_at_most(policy.MOST_AMPLITUDES_BESIDE_A_PILE) for kind in kinds]
    lacking = {kind.cause.label: kind.limit.words for kind in kinds if kind.limit.words}
    # Columns hardly change as corrections are taken.
    kinds = [kind for kind in kinds if kind.limit.degree >= kind.effect.lowest]
    candidates = [
        candidate
        for candidate in each(
            lambda kind: None if limits.is_over else CorrectionCandidate.at(kind, first), kinds
        )
        if candidate is not None
    ]
    trial = _linear_trial(first, candidates, tell, limits)
    of_session = [part for part in trial.parts if not part.is_predicted]
    if of_session:
        tell("correcting by what predictions have alone")
        predicted = [candidate.as_predicted for candidate in candidates]
        trial = _linear_trial(first, [c for c in predicted if c is not None], tell, limits)
    if standing_in and not is_piled and not limits.is_over:
        asked = [leader.as_predicted for leader in trial.leaders]
        again = [CorrectionCandidate.at(leader.kind, searched) for leader in asked if leader is not None]
        other = _linear_trial(searched, again, tell, limits)
        lead = other.fit.log_evidence - trial.fit.log_evidence
        if trial.parts and lead > policy.LEAST_LOG_EVIDENCE_CORRECTED:
            trial, corrects_already = other, True  # with or without a correction beside them
        elif other.parts and not trial.parts:
            trial = other
    is_last = causes.observations is first.observations
    best = trial.in_full(lacking, corrects_already, None if is_last else _tolerance(trial.fit))
    best = replace(best, of_session=tuple(of_session), is_cut_short=limits.is_over)
    if is_last or not best.is_taken:
        return best
    corrected, readings = best.fit, causes.observations
    rules = corrected.posterior.model.rules
    final = fit_rig(corrected.rig, readings, corrected.values, rules, tolerance=_tolerance(corrected))
    return replace(best, final=final)


def _tolerance(fit: Fit) -> float:
    """Gain in log density below which the fit of a corrected model stops where no name depends on it."""
    return 0.5 * len(fit.rig.free) * policy.CORRECTED_TO_SD**2


@dataclass(frozen=True)
class _LinearTrial:
    """Corrections that were taken in the linear model.

    Attributes:
        before: The full fit without them.
        fit: With them, in the linear model about the fit before.
        parts: The corrections, as they were taken.
        leaders: Candidates that had most evidence when none was taken.
    """

    before: Fit
    fit: Fit
    parts: tuple[Part, ...]
    leaders: Sequence[CorrectionCandidate]

    def in_full(
        self, lacking: dict[str, str], corrects_already: bool, tolerance: float | None = None
    ) -> Correction:
        """Correction by this trial after a full fit.

        Refused where the full fit has no more evidence than the fit before, or predicts places held out no better.

        Args:
            lacking: By kind and place why no higher degree was asked.
            corrects_already: Whether the fit before them stands in their place then, for its causes stand in for something unknown.
            tolerance: Gain in log density below which the full fit stops, where a fit to more readings follows.
        """
        before = self.before
        if not self.parts:
            refusal = "no correction has clear evidence and predicts places held out better"
            return Correction(before, (), lacking, "" if corrects_already else refusal, before)
        fit = full_fit(self.fit, before, tolerance)
        gain = held_out(before, fit, pose_blocks(fit.observations, np.random.default_rng(0)))
        if gain.elpd_difference <= 0.0 or fit.log_evidence <= before.log_evidence:
            refusal = "fitted in full, what was tried predicts places held out no better"
            return Correction(before, (), lacking, "" if corrects_already else refusal, before)
        return Correction(fit, self.parts, lacking, "", fit)


def _linear_trial(
    fit: Fit, candidates: Sequence[CorrectionCandidate], tell: Callable[[str], None], limits: Limits
) -> _LinearTrial:
    """Correct a fit by what has clear evidence and predicts blocks of places held out better, the best first.

    Args:
        fit: With all causes.
        candidates: Kinds of corrections, with columns of a similar fit.
        tell: Called with a message for each correction that is taken.
        limits: No further correction is asked when they are over.
    """
    before, leaders = fit, candidates
    block = pose_blocks(fit.observations, np.random.default_rng(0))
    parts = list[Part]()
    while candidates and len(parts) < policy.MOST_CORRECTIONS and not limits.is_over:
        options = list(each(partial(CorrectionCandidate.best_option, fit=fit), candidates))
        order = sorted(range(len(options)), key=lambda i: options[i].log_bayes_factor, reverse=True)
        ranked = [candidates[i] for i in order[: policy.MOST_ASKED_AGAIN + 1]]
        if len(ranked) < len(candidates):  # when none was taken
            leaders = ranked
        best = options[order[0]]
        if best.log_bayes_factor <= policy.LEAST_LOG_EVIDENCE_CORRECTED:
            break
        candidates = ranked[1:]
        after = best.fitted(fit)
        gain = held_out(fit, after, block)
        log_bayes_factor = after.log_evidence - fit.log_evidence
        if gain.elpd_difference <= 0.0 or log_bayes_factor <= 0.0:
            continue
        label = best.kind.cause.label
        tell(f"correcting by {label} to degree {best.degree} ({odds(log_bayes_factor)} for it)")
        kind = best.kind
        as_predicted = kind.as_predicted(fit.rig)
        is_predicted = as_predicted is not None and as_predicted.limit.degree >= best.degree
        extent = extent_of(kind.cause, best.degree, after)
        parts.append(
            Part(kind.cause, best.degree, len(best.widths), log_bayes_factor, gain, extent, is_predicted)
        )
        fit = after
    return _LinearTrial(before, fit, tuple(parts), leaders)
