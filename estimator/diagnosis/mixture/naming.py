"""The causes that an answer states, as a verdict lists them, and the fit of the rig with them."""

from __future__ import annotations

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.mixture.answer import Answer, Found
from estimator.diagnosis.mixture.items import Item
from estimator.diagnosis.verdict import Alternative, NamedCause
from estimator.effects.attach import with_effect


def named_by(answer: Answer) -> list[NamedCause]:
    """The stated causes, surest first, each with its alternatives and what else it may be."""
    return [_named(answer, entry) for entry in answer.stated]


def _named(answer: Answer, found: Found) -> NamedCause:
    listed = [possibility for possibility in found.possibilities if possibility.is_listed]
    first, *others = listed
    asked, item = answer.asked, _item_of(answer, found)
    beside = [i for i in asked.leading if i != item]
    return NamedCause(
        first.cause,
        found.probability * first.share,
        tuple(Alternative(other.cause, found.probability * other.share, None) for other in others),
        float(asked.slots.products.beside(beside, asked.noise)[item]),
        1.0 - found.probability * sum(possibility.share for possibility in listed),
    )


def _item_of(answer: Answer, found: Found) -> int:
    """Number of the most probable item of the cause that comes first."""
    asked = answer.asked
    cause = next(p.cause for p in found.possibilities if p.is_listed)
    own = [i for i, item in enumerate(asked.dictionary.items) if item.cause == cause]
    in_leading = [i for i in own if i in asked.leading]
    return in_leading[0] if in_leading else max(own, key=lambda i: float(asked.samples.present[i]))


def fitted_with_stated(answer: Answer) -> Fit:
    """The rig as described with the stated causes, fitted to the readings that were asked."""
    expansion = answer.asked.expansion
    plain, fit = expansion.plain, expansion.fit
    items = [_item_of(answer, entry) for entry in answer.stated]
    rig = plain.rig
    for i in items:
        item = answer.asked.dictionary.items[i]
        rig = with_effect(rig, item.cause, plain.observations, _start(item, fit))
    return fit_rig(rig, plain.observations, fit.values, plain.posterior.model.rules)


def _start(item: Item, fit: Fit) -> dict[str, float]:
    """Shapes of a cause: as fitted where the fit has it."""
    own = {key: fit.values.get(f"{item.cause.label}.{key}") for key in item.start}
    return {key: item.start[key] if value is None else float(value) for key, value in own.items()}
