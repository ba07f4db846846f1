"""The instant from which on something is otherwise, between two readings: causes start on a coarse grid of instants.

Half a gap of that grid beside the truth, some readings count to the wrong side, and their error would be left.
"""

from __future__ import annotations

import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate, at_starts
from estimator.diagnosis.hypotheses.screening import linear_evidence
from estimator.diagnosis.linear import log_mean_exp

SINCE = "since_h"
MOST_INSTANTS = (
    48  # that are asked about the best of the coarse grid: all, where 500 readings have 24 coarse instants
)


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
    coarse_h, since_h = circumstances.instants_h, start.shapes[SINCE]
    begin_h = max((t for t in coarse_h if t < since_h), default=0.0)
    end_h = min((t for t in coarse_h if t > since_h), default=circumstances.duration_h)
    times_h = circumstances.hours.unique()
    between_h = 0.5 * (times_h[1:] + times_h[:-1])
    between_h = between_h[(between_h > begin_h) & (between_h < end_h)]
    if len(between_h) < 2:
        return screened, start
    rows = torch.linspace(0, len(between_h) - 1, min(MOST_INSTANTS, len(between_h))).round().long().unique()
    starts = [{**start.shapes, SINCE: instant_h} for instant_h in between_h[rows].tolist()]
    finer = at_starts(fit, start.cause, starts)
    if not finer:
        return screened, start
    values = torch.tensor(linear_evidence(fit, [start, *finer]), dtype=torch.float64)
    top = int(values[1:].argmax())
    return screened + log_mean_exp(values[1:]) - float(values[0]), finer[top]
