"""Full fits of rigs with the causes of an answer, each made where it is asked for the first time."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from types import MappingProxyType

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.expansion import with_tails
from estimator.effects.attach import with_effect
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig


def leading_fit(answer: Answer) -> Fit:
    """The fit of the listed causes that lead, to the readings without the departures that lead."""
    asked, items, leading = answer.asked, answer.asked.dictionary.items, answer.leading_as_stated
    causes = {items[i].cause for i in leading if items[i].is_listed}
    has_departures = any(not items[i].is_listed for i in leading)
    if causes == set(asked.expansion.causes) and not has_departures:
        return asked.expansion.fit
    sizes, _ = asked.slots.products.sizes(leading, asked.noise)
    return _once(
        answer, _departed(answer), lambda: asked.expansion.moved(asked.dictionary, leading, sizes).fit
    )


def fit_with(answer: Answer, causes: Sequence[Cause]) -> Fit:
    """The rig as described with some listed causes, fitted to the readings that were asked."""
    if not causes:
        return answer.plain
    key = (frozenset(causes),)
    return _once(answer, key, lambda: fit_to(answer, causes, answer.plain.observations))


def fit_beside_departures(answer: Answer, causes: Sequence[Cause]) -> Fit:
    """The rig as described with some listed causes, fitted to the readings without the departures that lead."""
    readings = leading_fit(answer).observations
    if readings is answer.plain.observations:
        return fit_with(answer, causes)
    key = (frozenset(causes), *_departed(answer))
    return _once(answer, key, lambda: fit_to(answer, causes, readings))


def fit_to(
    answer: Answer,
    causes: Sequence[Cause],
    readings: Observations,
    shapes: Mapping[Cause, dict[str, float]] = MappingProxyType({}),
    tolerance: float | None = None,
) -> Fit:
    """The rig as described with some listed causes, fitted to some readings.

    Args:
        answer: What is known of them.
        causes: Beyond those of the rig.
        readings: Of the session, with or without what departures change.
        shapes: Where fits of some causes start; by default at the shapes that are known of them.
        tolerance: Where a further step raises the log density by less, the fit ends, and no prior is widened.
    """
    plain, known = answer.plain, answer.asked.expansion

    def rig_with(more: Mapping[Cause, float]) -> Rig:
        rig = plain.rig
        for cause in causes:
            at = shapes.get(cause) or answer.shapes_of(cause)
            factor = {**known.factors, **more}.get(cause, 1.0)
            rig = with_effect(rig, cause, plain.observations, at, factor=factor)
        return rig

    has_more_departures = readings is plain.observations and bool(known.departed_T.any())
    fit = fit_rig(
        rig_with({}),
        readings,
        known.fit.values,
        plain.posterior.model.rules,
        tolerance=tolerance,
        other_start=plain.noises if has_more_departures else None,
        ends_exact=tolerance is None,
    )
    if tolerance is not None:
        return fit
    return with_tails(fit, [cause for cause in causes if cause not in known.causes], rig_with)[0]


def _departed(answer: Answer) -> tuple[Hashable, ...]:
    """What tells the readings without the departures that lead from others."""
    return answer.leading_as_stated, answer.asked.noise_number


def _once(answer: Answer, key: tuple[Hashable, ...], make: Callable[[], Fit]) -> Fit:
    if key not in answer.fits:
        answer.fits[key] = make()
    return answer.fits[key]
