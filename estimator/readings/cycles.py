"""Whether commanded currents repeat in a cycle, whose time is no property of the clock."""

from __future__ import annotations

from estimator.readings.observations import Observations
from estimator.tensors import torch

FEWEST_CYCLES = 3
LEAST_REPEATED = 0.9  # of the readings: the others stand at a pause, or were left out
MOST_IN_CYCLE = 60  # readings
SAME_PERIOD = 0.02  # of a cycle
CYCLE = "the cycle of the commanded currents"


def cycle_of_currents_s(observations: Observations) -> float | None:
    """Time after which the commanded currents of a session come again, in s; None where they do not repeat, or never change.

    Args:
        observations: Some readings; the history of their session counts.
    """
    history = observations.history
    time_s, first = torch.unique(history.time_s, return_inverse=True)
    row = torch.full_like(time_s, len(history), dtype=torch.int64).scatter_reduce(
        0, first, torch.arange(len(history), device=first.device), "amin"
    )
    current_A = history.current_A[row]
    if bool((current_A == current_A[0]).all()):
        return None
    for n in range(2, min(len(time_s) // FEWEST_CYCLES, MOST_IN_CYCLE) + 1):
        is_same = (current_A[n:] == current_A[:-n]).all(-1)
        if float(is_same.double().mean()) >= LEAST_REPEATED:
            return float((time_s[n:] - time_s[:-n]).median())
    return None


def is_of_cycle(period_s: float, cycle_s: float | None, session_s: float) -> bool:
    """Whether a period in time is that of a cycle, or a whole fraction of it, as well as half cycles per session tell periods apart.

    Args:
        period_s, cycle_s: Both times; no cycle is None.
        session_s: Duration of the session.

    Examples:
        >>> [is_of_cycle(period_s, 6.0, 240.0) for period_s in (6.01, 3.0, 5.5, 12.0)]
        [True, True, False, False]
    """
    if cycle_s is None:
        return False
    n = max(round(cycle_s / period_s), 1)
    return abs(n * period_s / cycle_s - 1.0) < max(SAME_PERIOD, 0.25 * period_s / session_s)
