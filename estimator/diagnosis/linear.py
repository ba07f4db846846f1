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

NEWTON_STEPS = 20


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


@dataclass(frozen=True)
class FreeNoise:
    """A noise that was fitted and would shrink if more were explained, as far as its prior allows.

    Attributes:
        n: Number of components.
        width: Of its prior, in the logarithm. The slope of the prior at the fit is balanced by that of the data there.
    """

    n: float
    width: float

    def gain(self, gain: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
        """Twice the gain in log density after the noise has followed, given the fall of the sum of squares."""
        left = (1.0 - gain / self.n).clamp(min=0.0)
        shrink = 0.5 * torch.log(left.clamp(min=1e-6))
        for _ in range(NEWTON_STEPS):
            squares = left * torch.exp(-2.0 * shrink)
            slope = self.n * (squares - 1.0) - shrink / self.width**2
            shrink = shrink + (slope / (2.0 * self.n * squares + 1.0 / self.width**2)).clamp(-1.0, 1.0)
        squares = left * torch.exp(-2.0 * shrink)
        density = -self.n * shrink - 0.5 * self.n * (squares - 1.0)
        prior = -0.5 * (shrink / self.width) ** 2
        return 2.0 * (density + prior)


def log_bayes_factor(
    gram: Float[Tensor, "*batch column column"],
    score: Float[Tensor, "*batch column"],
    prior_sd: Float[Tensor, "*batch column"],
    noise: FreeNoise | None = None,
    started: float = 0.0,
) -> Float[Tensor, "*batch"]:
    """Log evidence gained by columns with normal priors about zero.

    Args:
        gram: T^T P T of the projected columns.
        score: T^T r, with r the whitened residual of the fit.
        prior_sd: Of the columns' coefficients.
        noise: Where the noise was fitted; it then follows. None where it is known.
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
    if noise is not None:
        gain = noise.gain(gain)
    evidence: Tensor = 0.5 * gain - occam
    return evidence


def log_mean_exp(values: Float[Tensor, " value"]) -> float:
    """Logarithm of the mean of exponentials: evidence averaged over equally likely alternatives."""
    return float(torch.logsumexp(values, 0)) - math.log(len(values))
