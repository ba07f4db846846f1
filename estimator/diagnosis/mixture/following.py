"""Readings that follow the rig's numbers no longer, as at the limit of a range: no model that is linear about them can undo the limit."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.rig.rig import Cause

FOLLOWS = 0.5  # of how a reading followed the rig's numbers, below which it does so no longer


def stalled(before: Fit, now: Fit) -> Bool[Tensor, " component"]:
    """Which readings follow the numbers that two fits share much less in the later one."""
    return _follow_less(_slopes(before, before, now), _slopes(now, before, now))


def limiting(plain: Fit, fit: Fit) -> frozenset[Cause]:
    """Causes of a fit without which readings would follow the rig's numbers that do not follow them."""
    if not bool(stalled(plain, fit).any()):
        return frozenset()
    now = _slopes(fit, plain, fit)
    return frozenset(
        cause
        for cause in fit.rig.effects
        if cause not in plain.rig.effects and bool(_follow_less(_without(fit, cause, plain), now).any())
    )


def _without(fit: Fit, cause: Cause, plain: Fit) -> Float[Tensor, "component coordinate"]:
    """Slopes of a fit where one of its causes changes nothing."""
    rows, nulls = fit.at_null(cause)
    vector = fit.vector.clone()
    vector[rows] = nulls
    shared = torch.tensor(_shared(fit, plain, fit), device=vector.device)
    return fit.posterior.to_first_order(vector[None], shared).jacobian_T[0]


def _slopes(fit: Fit, first: Fit, second: Fit) -> Float[Tensor, "component coordinate"]:
    """Derivatives of a fit's predictions in the coordinates that two fits share, in T."""
    slopes: Tensor = fit.jacobian / fit.whitening_per_T.clamp(min=1e-300)[:, None]
    return slopes[:, _shared(fit, first, second)]


def _shared(fit: Fit, first: Fit, second: Fit) -> list[int]:
    """Coordinates of a fit that both of two fits have, in the order of the first."""
    keys = [
        list(zip(c.names, c.labels, strict=True))
        for c in (f.posterior.coordinates for f in (fit, first, second))
    ]
    return [keys[0].index(key) for key in keys[1] if key in keys[2]]


def _follow_less(
    before: Float[Tensor, "component coordinate"], now: Float[Tensor, "component coordinate"]
) -> Bool[Tensor, " component"]:
    scale = before.square().sum(0).clamp(min=1e-300)
    followed, follows = ((slopes.square() / scale).sum(1) for slopes in (before, now))
    return follows < FOLLOWS**2 * followed
