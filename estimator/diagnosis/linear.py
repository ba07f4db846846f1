"""Evidence for more columns in a linear model with normal noise and priors: the algebra behind screening and resolution.

At the maximum of a fit the whitened residual r is what new columns T could explain after the fitted columns J have taken their part.
With priors on both the gain in evidence is closed; where the noise is fitted too, its profile replaces the quadratic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Projector:
    """Takes out of whitened vectors what the fitted parameters can follow, within their priors.

    Attributes:
        jacobian: Whitened derivative of the predictions.
        factor: Inverse square root of the fit's precision: J (J^T J + prior)^-1 J^T = (J F)(J F)^T.
    """

    jacobian: Float[Tensor, "component parameter"]
    factor: Float[Tensor, "parameter parameter"]

    @classmethod
    def of(
        cls,
        jacobian: Float[Tensor, "component parameter"],
        prior_precision: Float[Tensor, "parameter parameter"],
    ) -> Projector:
        """The projector of a fit."""
        precision = jacobian.T @ jacobian + prior_precision
        scale = torch.diagonal(precision).clamp(min=1e-300).rsqrt()
        values, vectors = torch.linalg.eigh(precision * scale[:, None] * scale[None, :])
        factor = scale[:, None] * vectors * values.clamp(min=1e-14).rsqrt()
        return cls(jacobian, factor)

    def gram(
        self, one: Float[Tensor, "component column"], other: Float[Tensor, "component column2"]
    ) -> Float[Tensor, "column column2"]:
        """Inner products of two sets of vectors after projection."""
        follow_one, follow_other = (self.factor.T @ (self.jacobian.T @ v) for v in (one, other))
        product: Tensor = one.T @ other - follow_one.T @ follow_other
        return product


def log_bayes_factor(
    gram: Float[Tensor, "*batch column column"],
    score: Float[Tensor, "*batch column"],
    prior_sd: Float[Tensor, "*batch column"],
    n_free_noise: float | None = None,
    started: float = 0.0,
) -> Float[Tensor, "*batch"]:
    """Log evidence gained by columns with normal priors about zero.

    Args:
        gram: T^T P T of the projected columns.
        score: T^T r, with r the whitened residual of the fit.
        prior_sd: Of the columns' coefficients.
        n_free_noise: Number of components where the noise was fitted; its profile then bends the gain. None where it is known.
        started: Gain in log density of the start about which the columns are taken, where that is not the fit itself.
    References: MacKay, Information Theory, Inference, and Learning Algorithms (2003), section 28.1.
    Examples:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> round(log_bayes_factor(100.0 * one[None], 60.0 * one, one).item(), 3)  # 6 sigma, prior 10 sigma wide
        15.514
    """
    scaled = gram * prior_sd[..., :, None] * prior_sd[..., None, :]
    precision = scaled + torch.eye(scaled.shape[-1], dtype=scaled.dtype)
    factor = torch.linalg.cholesky(precision)
    white = torch.linalg.solve_triangular(factor, (score * prior_sd)[..., None], upper=False)[..., 0]
    gain = (white**2).sum(-1) + 2.0 * started
    occam = torch.log(torch.diagonal(factor, dim1=-2, dim2=-1)).sum(-1)
    if n_free_noise is not None:
        gain = -n_free_noise * torch.log1p(-(gain / n_free_noise).clamp(max=1.0 - 1e-12))
    evidence: Tensor = 0.5 * gain - occam
    return evidence


def log_mean_exp(values: Float[Tensor, " value"]) -> float:
    """Logarithm of the mean of exponentials: evidence averaged over equally likely alternatives."""
    return float(torch.logsumexp(values, 0)) - math.log(len(values))
