"""Impact of a cause: how far it pulls the other parameters of a fit."""

from __future__ import annotations

import torch

from estimator.diagnosis.fitting import Fit
from estimator.effects import EFFECTS
from estimator.rig.rig import Cause


def impact_sd(fit: Fit, cause: Cause) -> dict[str, float]:
    """Shift of each free parameter, in its standard deviations, if the cause were put to its null and the others fitted again.

    To first order: covariance with the cause's quantities, over their covariance, times their distance from the null.

    Args:
        fit: With the cause.
        cause: One of its rig.
    Returns: By name of the parameter; empty where no quantity of the cause is free.
    References: ATLAS and CMS, ATL-PHYS-PUB-2011-11, for impacts and pulls of nuisance parameters.
    """
    coordinates = fit.posterior.coordinates
    quantities = EFFECTS[cause.name].quantities(fit.posterior.model.circumstances.extent)
    nulls = {f"{cause.label}.{q.key}": q.null for q in quantities if not q.is_shape and not q.is_positive}
    own = [i for i, name in enumerate(coordinates.names) if name in nulls]
    if not own:
        return {}
    null = torch.tensor([nulls[coordinates.names[i]] for i in own], dtype=torch.float64)
    within = fit.covariance[own][:, own]
    shift = fit.covariance[:, own] @ torch.linalg.solve(within, null - fit.vector[own])
    sd = torch.diagonal(fit.covariance).sqrt()
    return {
        name: float(shift[i] / sd[i])
        for i, name in enumerate(coordinates.names)
        if not name.startswith(f"{cause.label}.")
    }
