"""The instant from which on something is otherwise, between two readings: causes start on a coarse grid of instants.

Half a gap of that grid beside the truth, some readings count to the wrong side, and their error would be left.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import at_starts
from estimator.diagnosis.hypotheses.screening import Screened, linear_evidence
from estimator.diagnosis.linear import log_mean_exp
from estimator.effects.base import SINCE, UNTIL
from estimator.effects.circumstances import Circumstances

# Instants that are asked about the best of the coarse grid: all, where 500 readings have 24 coarse instants.
MOST_INSTANTS = 48


def at_finer_instant(fit: Fit, screened: Screened) -> Screened:
    """What the linear model says of a cause at the best instants between two readings near those of its coarse start.

    The evidence is averaged over the instants that are asked, so that a finer choice wins nothing by itself. Where something ends too, its
    beginning is asked first.

    Args:
        fit: Without the cause.
        screened: At its best coarse start; returned as it is where that has no instant.
    """
    circumstances = fit.posterior.model.circumstances
    value, highest, start = screened
    for key in instants_in(start.shapes):
        starts = starts_nearer(circumstances, circumstances.instants_h, start.shapes, key)
        finer = at_starts(fit, start.cause, starts) if len(starts) > 1 else []
        if finer:
            values = torch.tensor(linear_evidence(fit, [start, *finer]), dtype=torch.float64)
            coarse, top = float(values[0]), int(values[1:].argmax())
            value, highest = (
                value + log_mean_exp(values[1:]) - coarse,
                highest + float(values[1:].max()) - coarse,
            )
            start = finer[top]
    return Screened(value, highest, start)


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


def has_instant(starts: Sequence[Mapping[str, float]]) -> bool:
    """Whether starts have an instant from which on something is otherwise."""
    return any(SINCE in start for start in starts)


def best_instants(
    values: Sequence[float], starts: Sequence[Mapping[str, float]]
) -> list[tuple[float, Mapping[str, float]]]:
    """The best of the starts that differ by their instants alone, with its value; every start where they have none."""
    best: dict[tuple[tuple[str, float], ...], tuple[float, Mapping[str, float]]] = {}
    for value, start in zip(values, starts, strict=True):
        otherwise = tuple(item for item in start.items() if item[0] not in (SINCE, UNTIL))
        if otherwise not in best or value > best[otherwise][0]:
            best[otherwise] = value, start
    return list(best.values())
