"""Impact of a cause: how far it pulls the other parameters of a fit."""

from __future__ import annotations

import torch

from estimator.diagnosis.fitting import Fit
from estimator.rig.rig import Cause


def impact_sd(fit: Fit, cause: Cause) -> dict[str, float]:
    """Shift of each free parameter, in its standard deviations, if the cause were put to its null and the others fitted again.

    To first order: covariance with the cause's quantities, over their covariance, times their distance from the null.

    Args:
        fit: With the cause.
        cause: One of its rig.
    Returns: By name of the parameter; empty where no quantity of the cause is free, or where one cannot be at its null.
    References: ATLAS and CMS, ATL-PHYS-PUB-2011-11, for impacts and pulls of nuisance parameters.
    """
    coordinates = fit.posterior.coordinates
    own, null = fit.at_null(cause)
    if not own or not bool(torch.isfinite(null).all()):
        return {}
    within = fit.covariance[own][:, own]
    shift = fit.covariance[:, own] @ torch.linalg.solve(within, null - fit.vector[own])
    sd = torch.diagonal(fit.covariance).sqrt()
    return {
        name: float(shift[i] / sd[i])
        for i, name in enumerate(coordinates.names)
        if not name.startswith(f"{cause.label}.")
    }
