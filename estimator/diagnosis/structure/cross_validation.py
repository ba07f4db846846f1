"""How well a fit predicts each block of neighbouring places from all others, and where it would go without it, without fitting again.

At the maximum of a fit, leaving readings out moves the parameters by what their own leverage says. With r the whitened residual of a
block, J its whitened Jacobian and P the precision of the parameters from everything else, the readings of the block are predicted with
residual (1 - H)^-1 r and covariance (1 - H)^-1, where H = J C J^T with C = (P + J^T J)^-1; the parameters move by -C J^T (1 - H)^-1 r.
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

LEAST_SHARE = 1e-12  # of a block's own scatter that its parameters leave over: none where it alone determines one of them


@dataclass(frozen=True)
class HeldOut:
    """Gain of one fit over another in log predictive density of blocks that neither had seen.

    Attributes:
        gain: Summed over the blocks.
        se: Its standard error over the blocks.
    """

    gain: float
    se: float

    @property
    def is_loss(self) -> bool:
        """Whether a loss exceeds what chance leaves."""
        return self.gain < -policy.LEAST_HELD_OUT_LOSS_SE * self.se


def held_out(before: Fit, after: Fit, block: Int[np.ndarray, " reading"]) -> HeldOut:
    """What one fit gains over another, each block predicted from the others.

    Args:
        before, after: Fits of the same readings.
        block: Number of the block of every reading.
    """
    difference = log_predictive(after, block) - log_predictive(before, block)
    n = len(difference)
    se = float(difference.std()) * math.sqrt(n) if n > 1 else math.inf
    return HeldOut(float(difference.sum()), se)


def log_predictive(fit: Fit, block: Int[np.ndarray, " reading"]) -> Float[Tensor, " block"]:
    """Log predictive density of each block from the others, linear in the parameters about the fit and with its noise.

    References: Cook and Weisberg, Residuals and Influence in Regression (1982), section 2.2, for leaving out groups of readings.
    """
    densities = []
    for mine, share, vectors in _blocks(fit, block):
        off = (vectors.T @ fit.residual[mine]).square() / share
        normal = 0.5 * (torch.log(share) - off - math.log(2.0 * math.pi)).sum()
        densities.append(normal + torch.log(fit.whitening_per_T[mine]).sum())
    return torch.stack(densities)


def jackknife_covariance(
    fit: Fit, block: Int[np.ndarray, " reading"]
) -> Float[Tensor, "coordinate coordinate"]:
    """Covariance of a fit's coordinates from how they scatter as one block after another is left out.

    It needs no normal noise that is independent from reading to reading: what a wrong model leaves is as large in it as the disagreement
    of the blocks. What one block alone determines does not scatter, nor do priors.

    References: Bell and McCaffrey, Survey Methodology 28, 169 (2002), for blocks in linear models.
    """
    moves = []
    for mine, share, vectors in _blocks(fit, block):
        unsaid = torch.where(share > policy.LEAST_SHARE_JUDGED, vectors.T @ fit.residual[mine] / share, 0.0)
        moves.append(fit.covariance @ (fit.jacobian[mine].T @ (vectors @ unsaid)))
    moved = torch.stack(moves)
    return (1.0 - 1.0 / len(moved)) * moved.T @ moved


def _blocks(fit: Fit, block: Int[np.ndarray, " reading"]) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Components of each block, and eigenvalues and eigenvectors of 1 - H there."""
    reading = torch.arange(len(fit.observations))[:, None].expand(-1, 3)[fit.observations.is_measured]
    own_block = torch.from_numpy(block)[reading]
    for number in torch.unique(own_block):
        mine = own_block == number
        slope = fit.jacobian[mine]
        left = torch.eye(len(slope), dtype=torch.float64) - slope @ fit.covariance @ slope.T
        share, vectors = torch.linalg.eigh(left)
        yield mine, share.clamp(min=LEAST_SHARE), vectors
