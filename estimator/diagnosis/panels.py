"""Makes the panels of a diagnosis while its fits are still in memory: maps, races of hypotheses, shifts of parameters and plans."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.drawing import outline_of, rounded
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.headline import difference_words, headline
from estimator.diagnosis.impact import impact_sd
from estimator.diagnosis.mixture.comparison import NOTHING, Comparison, Hypothesis, credible
from estimator.diagnosis.next_readings.stops import best_to_shrink, candidate_stops
from estimator.diagnosis.panel_records import (
    Answer,
    Moved,
    NextMeasurement,
    Panels,
    Race,
    ResidualMap,
    Runner,
    Shown,
    Vectors,
)
from estimator.diagnosis.report import warnings_of
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.sizes import SizedCause
from estimator.diagnosis.structure.covariates import predicted_T
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent
from estimator.readings.observations import Observations
from estimator.readings.plan import plan_text
from estimator.reporting.numbers import (
    displays,
    interval_with_unit,
    odds,
    quantity_words,
    size_with_unit,
)
from estimator.rig.rig import Cause, Coil

MOST_MAPS, MOST_PATTERNS, MOST_RUNNERS, MOST_RACES, MOST_PLANS = 2, 6, 12, 6, 3
N_STOPS = 20  # of a plan that shrinks an interval
LEAST_SHRINK = 0.9  # of the standard deviation: a plan that leaves more is not worth its time


def panels(diagnosis: Diagnosis) -> Panels:
    """The panels of a diagnosis that has just been made."""
    plain, extended = diagnosis.fits.plain, diagnosis.fits.extended
    with torch.no_grad():
        noise_T = float(extended.posterior.component_sigma_T(extended.vector).median())
    return Panels(
        rig=diagnosis.rig.name,
        source=diagnosis.question.source,
        verdict=str(diagnosis.verdict),
        headline=headline(diagnosis),
        warnings=warnings_of(diagnosis),
        answers=[_answer(sized) for sized in diagnosis.sized_causes],
        n_readings=len(extended.observations),
        noise_T=noise_T,
        left_sigma=(_left_sigma(plain, extended), _left_sigma(extended)),
        maps=list(_maps(diagnosis)),
        races=[
            _race(diagnosis, title, comparison) for title, comparison in diagnosis.comparisons[:MOST_RACES]
        ],
        moved=_moved(diagnosis),
        next=_next(diagnosis),
    )


def panels_text(made: Panels) -> str:
    """Content of `panels.json`."""
    return json.dumps(asdict(made), allow_nan=False) + "\n"


def _answer(sized: SizedCause) -> Answer:
    sizes = [
        f"{quantity_words(key, sized.quantities)} {interval_with_unit(interval.median, *interval.ci90, interval.unit)}"
        for key, interval in sized.quantities.items()
        if interval.sd > 0.0
    ]
    if sized.difference is not None:
        sizes.append(difference_words(sized.difference))
    effect = EFFECTS[sized.cause.name]
    place, kind = sized.cause.place, str(effect.kind)
    return Answer(sized.name, place, kind, effect.words, sized.probability, sizes, list(sized.others))


def _maps(diagnosis: Diagnosis) -> Iterator[ResidualMap]:
    """Residuals around each coil that carried current, as vectors in its frame."""
    plain, extended = diagnosis.fits.plain, diagnosis.fits.extended
    is_on = extended.observations.current_A != 0.0
    measured_T = extended.observations.field_sensor_T
    is_known = ~measured_T.isnan().all(-1)
    alone = diagnosis.findings.answer.alone
    leaders = [h.cause for h in alone.hypotheses if h.cause is not None][:MOST_PATTERNS]
    powered = [i for i in range(is_on.shape[1]) if bool(is_on[:, i].any())]
    for i in powered[:MOST_MAPS]:
        coil = extended.rig.coils[i]
        rows = is_on[:, i] & is_known
        position_m, coil_from_sensor = extended.posterior.model.readings_in_coil(coil, extended.values)

        def shown(
            field_sensor_T: Float[Tensor, "reading 3"],
            rotation: Tensor = coil_from_sensor,
            rows: Tensor = rows,
        ) -> Vectors:
            return rounded((rotation @ field_sensor_T.nan_to_num()[..., None])[rows, :, 0])

        yield ResidualMap(
            coil=coil.name,
            winding=outline_of(extended, coil) if isinstance(coil, Coil) else None,
            position_m=rounded(position_m[rows]),
            before_T=shown(measured_T - predicted_T(plain)),
            after_T=shown(measured_T - predicted_T(extended)),
            patterns_T={diagnosis.label(cause): shown(_pattern_T(alone, cause)) for cause in leaders},
        )


def _pattern_T(comparison: Comparison, cause: Cause) -> Float[Tensor, "reading 3"]:
    """What a cause alone adds to the predictions, less what the rig's numbers can follow; 0 where a component was not measured."""
    fit = comparison.asked.expansion.fit
    change = comparison.change(comparison.best_item(cause)) / fit.whitening_per_T
    pattern_T = change.new_zeros(len(fit.observations), 3)
    pattern_T[fit.observations.is_measured] = change
    return pattern_T


def _race(diagnosis: Diagnosis, title: str, comparison: Comparison) -> Race:
    named = {cause.cause for cause in diagnosis.causes}
    same = credible(comparison.hypotheses) if comparison.taken else []

    def runner(hypothesis: Hypothesis) -> Runner:
        cause = hypothesis.cause
        role, item = "other", comparison.best_departure
        if cause in named:
            role = "named"
        elif hypothesis in same:
            role = "alternative"
        elif cause in diagnosis.findings.stand_ins:
            role = "stand-in"
        if cause is not None:
            words, item = EFFECTS[cause.name].words, comparison.best_item(cause)
        else:
            is_nothing = hypothesis.name == NOTHING
            words = "nothing wrong" if is_nothing else "a departure that no list holds"
            item = None if is_nothing else item
        label = diagnosis.label_of_hypothesis(hypothesis)
        return Runner(label, words, hypothesis.log_bayes_factor, role, comparison.left_sigma(item))

    ranked = sorted(comparison.hypotheses, key=lambda h: -h.log_bayes_factor)
    listed = [h for i, h in enumerate(ranked) if i < MOST_RUNNERS or h.cause is None]
    return Race(title if comparison.taken else "", [runner(h) for h in listed])


def _left_sigma(fit: Fit, noise_of: Fit | None = None) -> float:
    """Root mean square of the residual of a fit in units of its own noise, or of that of another fit."""
    other = noise_of or fit
    with torch.no_grad():
        residual_T = fit.posterior.measured_T - fit.posterior.predicted(fit.vector)
        sigma_T = other.posterior.component_sigma_T(other.vector)
    return float((residual_T / sigma_T).square().mean().sqrt())


def _moved(diagnosis: Diagnosis) -> list[Moved]:
    """Free numbers of the rig, those that moved farthest first."""
    plain, final = diagnosis.fits.plain, diagnosis.fits.final
    names = [p.name for p in diagnosis.rig.free if p.name in final.posterior.coordinates.names]
    pulls: dict[Cause, dict[str, float]] = {cause: impact_sd(final, cause) for cause in final.rig.effects}
    display = displays(names)
    result = []
    for name in names:
        before = (float(plain.values[name]), plain.value_sd(name))
        after = (float(final.values[name]), diagnosis.value_sd(name))
        if before[1] > 0.0 and after[1] > 0.0:
            shown_as = display[name]
            of_causes = {diagnosis.label(c): pulled[name] for c, pulled in pulls.items() if name in pulled}
            shown = Shown(name, shown_as.words, shown_as.unit, shown_as.factor)
            result.append(Moved(shown, before, after, (after[0] - before[0]) / before[1], of_causes))
    return sorted(result, key=lambda moved: -abs(moved.moved_sd))


def _next(diagnosis: Diagnosis) -> list[NextMeasurement]:
    """What would tell alternatives apart; else what would shrink the interval of the first cause's clearest size."""
    proposals = diagnosis.left_open.next_measurements
    if proposals:
        return [
            NextMeasurement(
                proposal.action.words,
                f"tells {' from '.join(proposal.splits)}: expected {odds(proposal.expected_log_evidence)}",
                f"Turn {', '.join(proposal.action.turned)} first." if proposal.action.turned else "",
                _plan(diagnosis, proposal.action.words, proposal.action.readings),
                len(proposal.action.readings),
            )
            for proposal in proposals[:MOST_PLANS]
        ]
    final = diagnosis.fits.final
    for named in diagnosis.causes:
        name = _clearest(diagnosis, named.cause)
        if name is None:
            continue
        stops = candidate_stops(final.observations)
        rows, sds = best_to_shrink(final, [name], stops, N_STOPS)
        if float(sds[-1]) > LEAST_SHRINK * float(sds[0]):
            continue
        words = f"{len(rows)} readings that determine {quantity_words(name.rpartition('.')[2])} of {diagnosis.label(named.cause)}"
        unit = final.rig.parameters[name].unit
        before, after = (size_with_unit(float(sd), unit) for sd in (sds[0], sds[-1]))
        why = f"its standard deviation falls from {before} to {after}"
        return [NextMeasurement(words, why, "", _plan(diagnosis, words, stops.rows(rows)), len(rows))]
    return []


def _clearest(diagnosis: Diagnosis, cause: Cause) -> str | None:
    """The number of a cause that is farthest from zero in its standard deviations; None where no size is free."""
    final = diagnosis.fits.final
    sizes = [q.key for q in EFFECTS[cause.name].quantities(Extent()) if not q.is_shape]
    free = [f"{cause.label}.{key}" for key in sizes if f"{cause.label}.{key}" in final.values]
    clear = {name: abs(float(final.values[name])) / sd for name in free if (sd := final.value_sd(name)) > 0.0}
    return max(clear, key=clear.__getitem__, default=None)


def _plan(diagnosis: Diagnosis, words: str, readings: Observations) -> str:
    history_s = readings.history.time_s
    pace_s = float((history_s[-1] - history_s[0]) / max(len(history_s) - 1, 1)) or 1.0
    return plan_text(words, diagnosis.rig, readings, pace_s)
