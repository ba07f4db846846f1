"""Takes several causes at once where causes of many kinds have piled up; the linear model chooses one beside the other.

The source seems wrong there, and no cause gets a name for what it leads by: what counts is how well all of them together follow the field.
One comparison of all hypotheses for each would cost a full fit of hundreds of numbers for every leader.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import Candidate
from estimator.diagnosis.hypotheses.instants import at_finer_instant
from estimator.diagnosis.hypotheses.screening import screening
from estimator.diagnosis.hypotheses.several_places import with_several
from estimator.diagnosis.hypotheses.step import least_log_evidence
from estimator.diagnosis.linear import Projector

MOST_AT_ONCE = 12  # causes; each is chosen by another screening of all


def many_at_once(fit: Fit, pool: Sequence[Candidate]) -> Fit | None:
    """The fit with two or more further causes, whose evidence suffices beside each other; None where there are fewer.

    Only causes are asked that start at their null, for there the linear model holds.

    Args:
        fit: With the causes taken so far.
        pool: Columns of every cause at the fit.
    """
    asked = [
        candidate for candidate in pool if candidate.cause not in fit.rig.effects and candidate.is_at_null
    ]
    least = least_log_evidence(len({candidate.cause for candidate in pool}))
    chosen = chosen_one_by_one(fit, asked, least, MOST_AT_ONCE)
    if len(chosen) < 2:
        return None
    wider = with_several(fit, chosen, least)
    return wider if wider is not None and wider.log_evidence > fit.log_evidence else None


def chosen_one_by_one(fit: Fit, asked: Sequence[Candidate], least: float, most: int) -> list[Candidate]:
    """Candidates in the order in which each has most evidence beside those before it, in the linear model.

    Args:
        fit: Without them.
        asked: The candidates.
        least: Log evidence that each needs beside those before it.
        most: Number of them, at most.
    """
    chosen: list[Candidate] = []
    jacobian, prior = fit.jacobian, (fit.optimum.precision - fit.optimum.information)[0]
    beside = fit
    while len(chosen) < most:
        screened = screening(beside, asked)
        cause = max(screened, key=lambda cause: screened[cause].log_bayes_factor, default=None)
        if cause is None or screened[cause].log_bayes_factor <= least:
            break
        start = at_finer_instant(beside, screened[cause]).start
        chosen.append(start)
        asked = [candidate for candidate in asked if candidate.cause != cause]
        gradient = torch.cat((jacobian.new_zeros(jacobian.shape[1]), start.columns.T @ beside.residual))
        jacobian = torch.cat((jacobian, start.columns), dim=1)
        prior = torch.block_diag(prior, torch.diag(start.prior_sd**-2))
        projector = Projector.of(jacobian, prior)
        step = projector.factor @ (projector.factor.T @ gradient)
        beside = fit.to_first_order(projector, beside.residual - jacobian @ step)
    return chosen
