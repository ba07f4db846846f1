"""Predict each block of neighbouring positions from all others, and find how far the parameters move without it, with no further fit.

Let r be the whitened residual of a block at the maximum of a fit, J its whitened Jacobian and P the precision of the parameters from all
else. With C = (P + J^T J)^-1 and the leverage H = J C J^T, the block is predicted with residual (1 - H)^-1 r and covariance (1 - H)^-1.
Without it the parameters move by -C J^T (1 - H)^-1 r.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit

LEAST_SHARE = 1e-12  # smallest eigenvalue of 1 - H; 0 where the block alone determines a parameter


@dataclass(frozen=True)
class HeldOut:
    """Difference of two fits in log predictive density of blocks, each predicted from the others.

    Attributes:
        elpd_difference: Later fit less earlier fit, summed over the blocks.
        elpd_se: Its standard error over the blocks.
    """

    elpd_difference: float
    elpd_se: float

    @property
    def is_loss(self) -> bool:
        """Whether the elpd falls by more than chance explains."""
        return self.elpd_difference < -policy.LEAST_HELD_OUT_LOSS_SE * self.elpd_se

    def to_json(self) -> dict[str, float]:
        """As `diagnosis.json` holds it."""
        return {"gain": self.elpd_difference, "se": self.elpd_se}


def held_out(before: Fit, after: Fit, block: Int[np.ndarray, " reading"]) -> HeldOut:
    """Compare two fits by their predictions of each block from the others.

    Args:
        before, after: Fits of the same readings.
        block: Block number of each reading.
    """
    difference = log_predictive(after, block) - log_predictive(before, block)
    n = len(difference)
    se = float(difference.std()) * math.sqrt(n) if n > 1 else math.inf
    return HeldOut(float(difference.sum()), se)


def log_predictive(fit: Fit, block: Int[np.ndarray, " reading"]) -> Float[Tensor, " block"]:
    """Log predictive density of each block from the others, to first order about the fit and with its noise.

    References: Cook and Weisberg, Residuals and Influence in Regression (1982), section 2.2, for leaving out groups of readings.
    """
    densities = []
    for in_block, share, vectors in _blocks(fit, block):
        distance2 = (vectors.T @ fit.residual[in_block]).square() / share
        normal = 0.5 * (torch.log(share) - distance2 - math.log(2.0 * math.pi)).sum()
        densities.append(normal + torch.log(fit.whitening_per_T[in_block]).sum())
    return torch.stack(densities)


def jackknife_covariance(
    fit: Fit, block: Int[np.ndarray, " reading"]
) -> Float[Tensor, "coordinate coordinate"]:
    """Block jackknife covariance of a fit's coordinates: their scatter as one block after another is left out.

    It assumes neither normal nor independent noise, so it also reflects the error of a wrong model, as far as the blocks disagree.
    Directions that one block alone determines, and priors, contribute nothing.

    References: Bell and McCaffrey, Survey Methodology 28, 169 (2002), for blocks in linear models.
    """
    shifts = []
    for in_block, share, vectors in _blocks(fit, block):
        error = torch.where(
            share > policy.LEAST_SHARE_JUDGED, vectors.T @ fit.residual[in_block] / share, 0.0
        )
        shifts.append(fit.covariance @ (fit.jacobian[in_block].T @ (vectors @ error)))
    shift = torch.stack(shifts)
    return (1.0 - 1.0 / len(shift)) * shift.T @ shift


def _blocks(fit: Fit, block: Int[np.ndarray, " reading"]) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """For each block the mask of its components, and the eigenvalues and eigenvectors of its 1 - H."""
    reading = torch.arange(len(fit.observations))[:, None].expand(-1, 3)[fit.observations.is_measured]
    block_of_component = torch.from_numpy(block)[reading]
    for number in torch.unique(block_of_component):
        in_block = block_of_component == number
        jacobian = fit.jacobian[in_block]
        unit = torch.eye(len(jacobian), dtype=torch.float64)
        share, vectors = torch.linalg.eigh(unit - jacobian @ fit.covariance @ jacobian.T)
        yield in_block, share.clamp(min=LEAST_SHARE), vectors
