"""How far the numbers of a fit move without one block of readings after another, with no further fit.

Let r be the whitened residual of a block at the maximum of a fit, J its whitened Jacobian and P the precision of the parameters from all
else. With C = (P + J^T J)^-1 and the leverage H = J C J^T they move by -C J^T (1 - H)^-1 r.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.diagnosis.fitting import Fit

# Of a block's own scatter in a direction, below which that block alone determines it
LEAST_SHARE_JUDGED = 1e-3

LEAST_SHARE = 1e-12  # smallest eigenvalue of 1 - H; 0 where the block alone determines a parameter


def jackknife_covariance(
    fit: Fit, block: Int[np.ndarray, " reading"]
) -> Float[Tensor, "coordinate coordinate"]:
    """Block jackknife covariance of a fit's coordinates: their scatter as one block after another is left out.

    It assumes neither normal nor independent noise, so it also reflects the error of a wrong model, as far as the blocks disagree.
    Directions that one block alone determines, and priors, contribute nothing.

    References: Bell and McCaffrey, Survey Methodology 28, 169 (2002), for blocks in linear models.
    """
    blocks = _Blocks.of(fit, block)
    error = torch.where(blocks.share > LEAST_SHARE_JUDGED, blocks.pull / blocks.share, 0.0)
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
