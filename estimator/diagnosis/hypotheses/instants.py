"""The instant from which on something is otherwise, between two readings: causes start on a coarse grid of instants.

Half a gap of that grid beside the truth, some readings count to the wrong side, and their error would be left.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import torch
from jaxtyping import Bool
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.effects import EFFECTS
from estimator.effects.base import AFTER
from estimator.effects.circumstances import SINCE, UNTIL, Circumstances
from estimator.effects.use import shifts_rows
from estimator.readings.observations import Observations

# Instants that are asked about the best of the coarse grid: all, where 500 readings have 24 coarse instants.
MOST_INSTANTS = 48
ALIKE = 1e-6  # difference of two log likelihoods that is rounding


def instants_in(start: Mapping[str, float]) -> list[str]:
    """Keys of the instants that a start has: at which something begins, and at which it ends."""
    return [key for key in (SINCE, UNTIL) if key in start]


def starts_nearer(
    circumstances: Circumstances, coarse_h: Collection[float], start: Mapping[str, float], key: str = SINCE
) -> list[dict[str, float]]:
    """A start at instants between readings, no farther from its own than the next coarse ones, nor beyond its other instant."""
    others_h = [*coarse_h, *(start[other] for other in instants_in(start) if other != key)]
    begin_h = max((t for t in others_h if t < start[key]), default=0.0)
    end_h = min((t for t in others_h if t > start[key]), default=circumstances.duration_h)
    return starts_between(circumstances, begin_h, end_h, start, key)


def starts_between(
    circumstances: Circumstances, begin_h: float, end_h: float, start: Mapping[str, float], key: str = SINCE
) -> list[dict[str, float]]:
    """A start with one of its instants between readings in a part of the session, spread over it where they are many."""
    times_h = circumstances.hours.unique()
    between_h = 0.5 * (times_h[1:] + times_h[:-1])
    between_h = between_h[(between_h > begin_h) & (between_h < end_h)]
    n = len(between_h)
    rows = torch.linspace(0, n - 1, min(MOST_INSTANTS, n), device=times_h.device).round().long().unique()
    return [{**start, key: instant_h} for instant_h in between_h[rows].tolist()]


def best_instants(
    values: Sequence[float], starts: Sequence[Mapping[str, float]]
) -> list[tuple[float, Mapping[str, float]]]:
    """The best of the starts that differ by their instants alone, with its value; every start where they have none.

    Of starts that change the readings alike, as exchanged columns of zeros do, only the first.
    """
    best: dict[tuple[tuple[str, float], ...], tuple[float, Mapping[str, float]]] = {}
    for value, start in zip(values, starts, strict=True):
        otherwise = tuple(item for item in start.items() if item[0] not in (SINCE, UNTIL))
        if otherwise not in best or value > best[otherwise][0]:
            best[otherwise] = value, start
    distinct: list[tuple[float, Mapping[str, float]]] = []
    for value, start in best.values():
        if not any(abs(value - other) < ALIKE for other, _ in distinct):
            distinct.append((value, start))
    return distinct


def changes_at_its_instant(fit: Fit) -> bool:
    """Whether readings on both sides of the last instant of a fit's newest cause show it, each time more than single ones.

    What begins before the first current of a session is what is wrong in all of it, and a row or two are mistakes of single rows. Fields
    beside their rows are joined anew for each instant, which no prediction tells.
    """
    cause = fit.rig.effects[-1]
    names = {key: f"{cause.label}.{key}" for key in (SINCE, UNTIL)}
    instants = [key for key in names if names[key] in fit.values]
    if not instants or shifts_rows(EFFECTS[cause.name]):
        return True
    begin, end = names[instants[0]], names[instants[-1]]
    after_h = fit.values[begin].new_tensor(AFTER * fit.circumstances.duration_h)
    never = {**fit.values, begin: after_h, end: after_h}
    ever = {**fit.values, end: after_h if end != begin else -torch.ones_like(after_h)}
    with torch.no_grad():
        here_T, *others_T = (
            fit.posterior.model.predict(values).expand(len(fit.observations), 3)
            for values in (fit.values, never, ever)
        )
    is_measured = fit.observations.is_measured
    differing = (((here_T != other_T) & is_measured).any(dim=1).sum() for other_T in others_T)
    return all(int(n) >= policy.FEWEST_OF_ONE_MISTAKE for n in differing)


def on_known_sides(fit: Fit, readings: Observations) -> Observations:
    """Readings that `are_on_known_sides`."""
    return readings.rows(are_on_known_sides(fit, readings))


def are_on_known_sides(fit: Fit, readings: Observations) -> Bool[Tensor, " reading"]:
    """Whether readings lie on a known side of each instant at which a cause of a fit begins or ends.

    The fitted readings leave the instant open over some of them: a block of unseen ones may lie there, and readings without a field tell
    nothing.

    Args:
        fit: Whose causes may begin or end at an instant.
        readings: Of the same session; those of another one all do.
    """
    circumstances = fit.circumstances
    hours = Circumstances(fit.rig, readings).hours
    is_known = torch.ones_like(hours, dtype=torch.bool)
    if readings.history is not circumstances.observations.history:
        return is_known
    for cause in fit.rig.effects:
        names = {key: f"{cause.label}.{key}" for key in (SINCE, UNTIL)}
        instants_h = {key: float(fit.values[name]) for key, name in names.items() if name in fit.values}
        for key in instants_h:
            first_h, last_h = _possible_from_to_h(
                fit,
                names[key],
                starts_nearer(circumstances, circumstances.coarse_instants_h, instants_h, key),
                key,
            )
            is_known &= (hours <= first_h) | (hours >= last_h)
    return is_known


def _possible_from_to_h(
    fit: Fit, name: str, starts: Sequence[Mapping[str, float]], key: str
) -> tuple[float, float]:
    """Times of the fitted readings between which an instant lies at odds of 20 to 1, in h.

    Args:
        fit: With the cause.
        name: Parameter that is the instant.
        starts: Instants that are asked beside that of the fit.
        key: Of the instant.
    """
    asked_h = fit.values[name].new_tensor([float(fit.values[name]), *(start[key] for start in starts)])
    with torch.no_grad():
        reading_T = fit.posterior.model.predict({**fit.values, name: asked_h})
        components_T = fit.posterior.measured_components(reading_T.expand(len(asked_h), -1, 3))
    whitened = (fit.posterior.measured_T - components_T) * fit.whitening_per_T
    log_likelihood = -0.5 * whitened.square().sum(-1)
    possible_h = asked_h[log_likelihood > log_likelihood.max() - policy.CLEAR_LOG_EVIDENCE]
    times_h = fit.circumstances.hours.unique()
    before, after = times_h[times_h < possible_h.min()], times_h[times_h >= possible_h.max()]
    return float(before[-1]) if len(before) else -math.inf, float(after[0]) if len(after) else math.inf
