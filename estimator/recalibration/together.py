"""Causes named by several disagreeing sessions in a row that none of them names alone.

Each session gives a Bayes factor of every cause against no cause, with its own size of the cause. Sessions are independent given the cause,
so their Bayes factors multiply; a cause that leads in one session by chance falls behind in the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch

from estimator.diagnosis import policy

NOTHING, UNEXPLAINED = "nothing", "unexplained"  # hypotheses beside the causes


def named_together(sessions: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The 95 % credible set of causes after some sessions, most probable first.

    Args:
        sessions: Log Bayes factor of each hypothesis against nothing, by name, for each session.
    Returns: Probabilities among all causes; empty while no cause, or an unknown one, is not ruled out.

    Examples:
        >>> session = {"offset_drift": 3.0, "coil_heating": -1.0, "unexplained": 1.0}
        >>> named_together([session]), list(named_together([session, session]))
        ({}, ['offset_drift'])
    """
    if not sessions:
        return {}
    common = set.intersection(*(set(session) for session in sessions)) - {NOTHING}
    total = {name: sum(session[name] for session in sessions) for name in common}
    unexplained = total.pop(UNEXPLAINED, 0.0) + policy.LOG_PRIOR_UNEXPLAINED
    if not total:
        return {}
    least = max(policy.LOG_PRIOR_NOTHING + policy.LEAST_LOG_ODDS, unexplained)
    ranked = sorted(total, key=lambda name: (-total[name], name))
    if total[ranked[0]] + policy.LOG_PRIOR_CAUSE - math.log(len(ranked)) <= least:
        return {}
    shares = torch.softmax(torch.tensor([total[name] for name in ranked], dtype=torch.float64), 0)
    n = int((torch.cumsum(shares, 0) < policy.CREDIBLE_SHARE).sum()) + 1
    return dict(zip(ranked[:n], shares[:n].tolist(), strict=True))
