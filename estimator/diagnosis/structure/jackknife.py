"""How far the numbers of a fit move without one block of readings after another, with no further fit.

Let r be the whitened residual of a block at the maximum of a fit, J its whitened Jacobian and P the precision of the parameters from all
else. With C = (P + J^T J)^-1 and the leverage H = J C J^T they move by -C J^T (1 - H)^-1 r.
"""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.diagnosis.fitting import Fit

# Of a block's own scatter in a direction, below which that block alone determines it
LEAST_SHARE_JUDGED = 1e-3


def jackknife_covariance(
    fit: Fit, block: Int[np.ndarray, " reading"]
) -> Float[Tensor, "coordinate coordinate"]:
    """Block jackknife covariance of a fit's coordinates: their scatter as one block after another is left out.

    It assumes neither normal nor independent noise, so it also reflects the error of a wrong model, as far as the blocks disagree.
    Directions that one block alone determines, and priors, contribute nothing.

    References: Bell and McCaffrey, Survey Methodology 28, 169 (2002), for blocks in linear models.
    """
    by_axis = torch.from_numpy(block).to(fit.observations.device)[:, None].expand(-1, 3)
    numbers, number = torch.unique(by_axis[fit.observations.is_measured], return_inverse=True)
    scale = torch.diagonal(fit.covariance).clamp(min=1e-300).sqrt()
    size, turn = torch.linalg.eigh(fit.covariance / (scale[:, None] * scale))
    # With C = F F^T the leverage of a block is (J F)(J F)^T; the eigenvectors of (J F)^T (J F) are few.
    root = scale[:, None] * turn * size.clamp(min=0.0).sqrt()
    jacobian = fit.jacobian @ root
    grams, pulls = [], []
    for i in range(len(numbers)):
        in_block = number == i
        grams.append(jacobian[in_block].T @ jacobian[in_block])
        pulls.append(jacobian[in_block].T @ fit.residual[in_block])
    leverage, vectors = torch.linalg.eigh(torch.stack(grams))
    share, pull = 1.0 - leverage, (vectors.mT @ torch.stack(pulls)[..., None])[..., 0]
    error = torch.where(share > LEAST_SHARE_JUDGED, pull / share, 0.0)
    shift = (vectors @ error[..., None])[..., 0] @ root.T
    return (1.0 - 1.0 / len(shift)) * shift.T @ shift
