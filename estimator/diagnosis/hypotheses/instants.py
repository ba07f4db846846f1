"""The instant from which on something is otherwise, between two readings: causes start on a coarse grid of instants.

Half a gap of that grid beside the truth, some readings count to the wrong side, and their error would be left.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate, at_starts
from estimator.diagnosis.hypotheses.screening import linear_evidence
from estimator.diagnosis.linear import log_mean_exp
from estimator.effects.circumstances import Circumstances

SINCE = "since_h"
# Instants that are asked about the best of the coarse grid: all, where 500 readings have 24 coarse instants.
MOST_INSTANTS = 48


def at_finer_instant(fit: Fit, screened: float, start: Candidate) -> tuple[float, Candidate]:
    """Log Bayes factor and start of a cause at the best instant between two readings near that of its coarse start.

    The evidence is averaged over the instants that are asked, so that a finer choice wins nothing by itself.

    Args:
        fit: Without the cause.
        screened: Log Bayes factor by the screening of the coarse start.
        start: Best of the coarse starts; returned as it is where it has no instant.
    """
    if SINCE not in start.shapes:
        return screened, start
    circumstances = fit.posterior.model.circumstances
    starts = starts_nearer(circumstances, circumstances.instants_h, start.shapes)
    if len(starts) < 2:
        return screened, start
    finer = at_starts(fit, start.cause, starts)
    if not finer:
        return screened, start
    values = torch.tensor(linear_evidence(fit, [start, *finer]), dtype=torch.float64)
    top = int(values[1:].argmax())
    return screened + log_mean_exp(values[1:]) - float(values[0]), finer[top]


def starts_nearer(
    circumstances: Circumstances, coarse_h: Collection[float], start: Mapping[str, float]
) -> list[dict[str, float]]:
    """A start at instants between readings, no farther from its own than the next coarse ones."""
    begin_h = max((t for t in coarse_h if t < start[SINCE]), default=0.0)
    end_h = min((t for t in coarse_h if t > start[SINCE]), default=circumstances.duration_h)
    return starts_between(circumstances, begin_h, end_h, start)


def starts_between(
    circumstances: Circumstances, begin_h: float, end_h: float, start: Mapping[str, float]
) -> list[dict[str, float]]:
    """A start at instants between readings in a part of the session, spread over it where they are many."""
    times_h = circumstances.hours.unique()
    between_h = 0.5 * (times_h[1:] + times_h[:-1])
    between_h = between_h[(between_h > begin_h) & (between_h < end_h)]
    n = len(between_h)
    rows = torch.linspace(0, n - 1, min(MOST_INSTANTS, n), device=times_h.device).round().long().unique()
    return [{**start, SINCE: instant_h} for instant_h in between_h[rows].tolist()]


def has_instant(starts: Sequence[Mapping[str, float]]) -> bool:
    """Whether starts have an instant from which on something is otherwise."""
    return any(SINCE in start for start in starts)


def best_instants(
    values: Sequence[float], starts: Sequence[Mapping[str, float]]
) -> list[tuple[float, Mapping[str, float]]]:
    """The best of the starts that differ by their instant alone, with its value; every start where they have none."""
    best: dict[tuple[tuple[str, float], ...], tuple[float, Mapping[str, float]]] = {}
    for value, start in zip(values, starts, strict=True):
        otherwise = tuple(item for item in start.items() if item[0] != SINCE)
        if otherwise not in best or value > best[otherwise][0]:
            best[otherwise] = value, start
    return list(best.values())
