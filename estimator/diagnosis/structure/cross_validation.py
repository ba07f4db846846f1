"""Predict each block of neighbouring positions from all others, and find how far the parameters move without it, with no further fit.

Let r be the whitened residual of a block at the maximum of a fit, J its whitened Jacobian and P the precision of the parameters from all
else. With C = (P + J^T J)^-1 and the leverage H = J C J^T, the block is predicted with residual (1 - H)^-1 r and covariance (1 - H)^-1.
Without it the parameters move by -C J^T (1 - H)^-1 r.
"""

from __future__ import annotations

import math
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
        """Difference and its standard error in the form of `diagnosis.json`."""
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
    known, key = fit.log_predictive_by_blocks, block.tobytes()  # asked of one fit again and again
    if key not in known:
        known[key] = _log_predictive(fit, block)
    return known[key]


def _log_predictive(fit: Fit, block: Int[np.ndarray, " reading"]) -> Float[Tensor, " block"]:
    blocks = _Blocks.of(fit, block)
    # With s = 1 - share an eigenvalue of the leverage, r^T (1 - H)^-1 r = r^T r + sum of pull^2 / share.
    distance2 = blocks.summed(fit.residual.square()) + (blocks.pull.square() / blocks.share).sum(-1)
    constant = 0.5 * math.log(2.0 * math.pi) * blocks.summed(torch.ones_like(fit.residual))
    normal = 0.5 * torch.log(blocks.share).sum(-1) - 0.5 * distance2 - constant
    return normal + blocks.summed(torch.log(fit.whitening_per_T))


def jackknife_covariance(
    fit: Fit, block: Int[np.ndarray, " reading"]
) -> Float[Tensor, "coordinate coordinate"]:
    """Block jackknife covariance of a fit's coordinates: their scatter as one block after another is left out.

    It assumes neither normal nor independent noise, so it also reflects the error of a wrong model, as far as the blocks disagree.
    Directions that one block alone determines, and priors, contribute nothing.

    References: Bell and McCaffrey, Survey Methodology 28, 169 (2002), for blocks in linear models.
    """
    blocks = _Blocks.of(fit, block)
    error = torch.where(blocks.share > policy.LEAST_SHARE_JUDGED, blocks.pull / blocks.share, 0.0)
    shift = (blocks.vectors @ error[..., None])[..., 0] @ blocks.root.T
    return (1.0 - 1.0 / len(shift)) * shift.T @ shift


@dataclass(frozen=True)
class _Blocks:
    """The leverage H = (J F)(J F)^T of each block, with C = F F^T, by the eigenvectors of (J F)^T (J F), which are few.

    Attributes:
        root: F.
        number: Block of each component.
        share: Eigenvalues of 1 - H that are not 1.
        vectors: Eigenvectors of (J F)^T (J F).
        pull: (J F)^T r along them.
    """

    root: Float[Tensor, "coordinate coordinate"]
    number: Int[Tensor, " component"]
    share: Float[Tensor, "block coordinate"]
    vectors: Float[Tensor, "block coordinate coordinate"]
    pull: Float[Tensor, "block coordinate"]

    @classmethod
    def of(cls, fit: Fit, block: Int[np.ndarray, " reading"]) -> _Blocks:
        """The blocks of a fit."""
        by_axis = torch.from_numpy(block).to(fit.observations.device)[:, None].expand(-1, 3)
        numbers, number = torch.unique(by_axis[fit.observations.is_measured], return_inverse=True)
        scale = torch.diagonal(fit.covariance).clamp(min=1e-300).sqrt()
        size, turn = torch.linalg.eigh(fit.covariance / (scale[:, None] * scale))
        root = scale[:, None] * turn * size.clamp(min=0.0).sqrt()
        jacobian = fit.jacobian @ root
        grams, pulls = [], []
        for i in range(len(numbers)):
            in_block = number == i
            grams.append(jacobian[in_block].T @ jacobian[in_block])
            pulls.append(jacobian[in_block].T @ fit.residual[in_block])
        leverage, vectors = torch.linalg.eigh(torch.stack(grams))
        pull = (vectors.mT @ torch.stack(pulls)[..., None])[..., 0]
        return cls(root, number, (1.0 - leverage).clamp(min=LEAST_SHARE), vectors, pull)

    def summed(self, by_component: Float[Tensor, " component"]) -> Float[Tensor, " block"]:
        """Sum over the components of each block."""
        total = by_component.new_zeros(len(self.share))
        return total.index_add(0, self.number, by_component)
