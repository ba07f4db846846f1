"""What corrects predictions without a name: the causes and departures that lead beside the stated causes, fitted in full.

Of what a current has done in this session only that is taken which a single moment has, for a prediction is of a stated current.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from torch import Tensor

from estimator.diagnosis import effort
from estimator.diagnosis.corrections.kinds import CorrectionKind, kinds_of
from estimator.diagnosis.corrections.result import Correction, Part, extent_of
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.found import Found
from estimator.diagnosis.mixture.links import Link
from estimator.effects.attach import with_effect
from estimator.reporting.numbers import size_with_unit
from estimator.rig.parameters import Normal, Parameter
from estimator.rig.rig import EVERYWHERE, Cause, Rig

MOST_STEPS = 3  # towards the widths that amplitudes have
FORMER = 4  # amplitudes that the width counts for which was asked: fewer could follow two or three terms
NEARLY = 0.25  # logarithm of the factor on a width from which on a fit is made again


def corrected(answer: Answer, extended: Fit, after: Fit, limits: Limits) -> Correction:
    """The correction of the rig with the stated causes by what leads beside them.

    Args:
        answer: What the readings say.
        extended: With the stated causes, fitted to the readings that were asked.
        after: The same, fitted to the readings that count.
        limits: Nothing is corrected when they are over.
    """
    if limits.is_over:
        return Correction(extended, (), {}, limits.words, after, is_cut_short=True)
    kinds = {kind.cause: kind for kind in kinds_of(extended)}
    lacking = {kind.cause.label: kind.limit.words for kind in kinds.values() if kind.limit.words}
    terms = _Terms(extended, extended.rig, dict(extended.values))
    departures, of_session = dict[Cause, tuple[Part, _AtPlace]](), list[Part]()
    for entry in answer.beside:
        if entry.first.is_listed:
            terms = terms.with_cause(answer, entry.first.cause)
            continue
        for at_place in _at_places(answer, answer.item_of(entry.first.cause)):
            kind = kinds.get(at_place.cause)
            if kind is None:
                continue
            part = _part(answer, entry, kind, at_place)
            if not part.is_predicted and entry.first.link is Link.CURRENT:
                of_session.append(part)
            else:  # a rig has each correction once, and the surest comes first
                departures.setdefault(at_place.cause, (part, at_place))
    for part, at_place in departures.values():
        terms = terms.with_departure(kinds[at_place.cause], part, at_place)
    parts, session = [part for part, _ in departures.values()], tuple(of_session)
    if terms.rig is extended.rig:
        refusal = "nothing beside the stated causes is sure enough to predict by"
        return Correction(extended, (), lacking, refusal, after, of_session=session)
    rules = extended.posterior.model.rules
    tolerance = 0.5 * len(terms.rig.free) * effort.CORRECTED_TO_SD**2
    fit = fit_rig(terms.rig, extended.observations, terms.start, rules, tolerance=tolerance, near=extended)
    fit = _of_own_widths(fit, parts, tolerance)
    parts, final = [_told(fit, part) for part in parts], fit
    if after.observations is not extended.observations:
        final = fit_rig(fit.rig, after.observations, fit.values, rules, tolerance=tolerance)
    return Correction(fit, tuple(parts), lacking, "", final, of_session=session)


def _of_own_widths(fit: Fit, parts: Sequence[Part], tolerance: float) -> Fit:
    """A fit with priors of each departure as wide as its amplitudes are."""
    for _ in range(MOST_STEPS):
        parameters = list[Parameter]()
        for widths, factor in (_widths(fit, part) for part in parts):
            if abs(math.log(factor)) > NEARLY:
                parameters += [replace(each, prior=Normal(0.0, factor * sd)) for each, sd in widths.items()]
        if not parameters:
            break
        rig, rules = fit.rig.with_parameters(parameters), fit.posterior.model.rules
        fit = fit_rig(rig, fit.observations, fit.values, rules, tolerance=tolerance, near=fit)
    return fit


def _widths(fit: Fit, part: Part) -> tuple[dict[Parameter, float], float]:
    """Prior width of each free amplitude of a part, and the factor on all of them that the evidence asks for.

    A departure was asked at a few widths, factors of four apart. Where nothing was read its intervals are as wide as its prior. The
    factor is one step towards the most probable width, with the former one counted as `FORMER` amplitudes.

    References: MacKay, Bayesian interpolation, Neural Computation 4 (1992) 415, equation 4.9.
    """
    prefix = f"{part.cause.label}."
    free = (parameter for parameter in fit.rig.free if parameter.name.startswith(prefix))
    widths = {parameter: parameter.prior.sd for parameter in free if parameter.prior is not None}
    square = sum((float(fit.values[each.name]) / width) ** 2 for each, width in widths.items())
    determined = sum(1.0 - (fit.value_sd(each.name) / width) ** 2 for each, width in widths.items())
    return widths, math.sqrt((FORMER + square) / (FORMER + max(determined, 0.0)))


def _told(fit: Fit, part: Part) -> Part:
    """A part whose degrees are alike says how large they are, and no degree."""
    if not part.is_whole:
        return part
    widths, factor = _widths(fit, part)
    parameter, width = next(iter(widths.items()))
    return replace(
        part, extent=f"of {size_with_unit(factor * width, parameter.unit, 2)} rms, {part.degree} in all"
    )


@dataclass(frozen=True)
class _AtPlace:
    """A departure that leads, at one place.

    Attributes:
        start: What its terms are functions of; empty where one kind has a single start.
        widths, sizes: Prior width and size of its amplitudes, by key.
    """

    cause: Cause
    start: dict[str, float]
    widths: dict[str, float]
    sizes: dict[str, float]


def _at_places(answer: Answer, number: int) -> list[_AtPlace]:
    """A departure that leads, place by place."""
    item, sizes = answer.asked.dictionary.items[number], answer.sizes_of(number).tolist()
    if item.cause.place != EVERYWHERE:
        return [
            _AtPlace(
                item.cause, item.start, *(dict(zip(item.keys, v, strict=True)) for v in (item.widths, sizes))
            )
        ]
    result = dict[str, _AtPlace]()
    for key, width, size in zip(item.keys, item.widths, sizes, strict=True):
        place, _, own = key.rpartition(".")
        at_place = result.setdefault(place, _AtPlace(Cause(item.cause.name, place), item.start, {}, {}))
        at_place.widths[own], at_place.sizes[own] = width, size
    return list(result.values())


def _part(answer: Answer, entry: Found, kind: CorrectionKind, at_place: _AtPlace) -> Part:
    """A departure at one place, as a correction has it."""
    number = answer.item_of(entry.first.cause)
    degree = max(degree for degree, key in kind.keys(kind.limit.degree) if key in at_place.widths)
    predicted = kind.as_predicted(answer.plain.rig)
    if predicted is not None and entry.first.link is Link.CURRENT:
        degree = min(degree, predicted.limit.degree)
    is_predicted = predicted is not None and predicted.limit.degree >= degree
    value = answer.beside_item(number).log_bayes_factor([entry.first.cause])
    n = len(kind.keys(degree))
    extent = extent_of(at_place.start, degree, answer.plain)
    return Part(at_place.cause, degree, n, value, entry.probability, extent, is_predicted)


@dataclass(frozen=True)
class _Terms:
    """A rig with further causes and corrections, and where its fit starts."""

    fit: Fit
    rig: Rig
    start: dict[str, Tensor | float]

    def with_cause(self, answer: Answer, cause: Cause) -> _Terms:
        """These terms with a listed cause."""
        shapes, factor = answer.shapes_of(cause), answer.asked.expansion.factors.get(cause, 1.0)
        rig = with_effect(self.rig, cause, self.fit.observations, shapes, factor=factor)
        return replace(self, rig=rig)

    def with_departure(self, kind: CorrectionKind, part: Part, at_place: _AtPlace) -> _Terms:
        """These terms with a correction, its amplitudes as wide as the departure that leads."""
        keys = {key for _, key in kind.keys(part.degree)}
        widths = {key: width for key, width in at_place.widths.items() if key in keys}
        rig = kind.rig(self.fit, at_place.start or kind.starts[0], widths, of=self.rig)
        amplitudes: dict[str, Tensor | float] = {
            f"{part.cause.label}.{key}": size for key, size in at_place.sizes.items() if key in keys
        }
        return replace(self, rig=rig, start=self.start | amplitudes)
