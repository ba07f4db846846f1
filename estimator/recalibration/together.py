"""Sessions in a row that disagree alike: what none of them can name alone, several may.

Each session gives every cause a Bayes factor against nothing, with a size of its own. Sessions are independent once the cause is given, so
their factors multiply; a cause that only chance put in front of one session does not stay there in the next.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch

from estimator.diagnosis import policy

NOTHING, UNEXPLAINED = "nothing", "unexplained"  # hypotheses beside the causes


def named_together(sessions: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The causes that hold 95 % of the probability after some sessions, most probable first.

    Args:
        sessions: Per session the log Bayes factor of each hypothesis against nothing, by name.
    Returns: Probabilities among all causes; empty where nothing, or something that no cause explains, is not yet ruled out.

    Examples:
        >>> one = {"offset_drift": 3.0, "coil_heating": -1.0, "unexplained": 1.0}
        >>> named_together([one]), list(named_together([one, one]))
        ({}, ['offset_drift'])
    """
    if not sessions:
        return {}
    known = set.intersection(*(set(session) for session in sessions)) - {NOTHING}
    total = {name: sum(session[name] for session in sessions) for name in known}
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
