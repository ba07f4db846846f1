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

from estimator.diagnosis import policy

N_SHRINKS = 101  # logarithms of the noise that are looked at
TINY = 1e-12  # square of a column, in units of the noise and its prior, below which nothing is said of it


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

    def rest(self, change: Float[Tensor, "component ..."]) -> Float[Tensor, "component ..."]:
        """What the fit cannot follow of one change of the readings, or of several."""
        followed: Tensor = self.jacobian @ (self.factor @ (self.factor.T @ (self.jacobian.T @ change)))
        return change - followed


@dataclass(frozen=True)
class FreeNoise:
    """A noise that was fitted and would shrink if more were explained, as far as its prior allows.

    Attributes:
        n: Number of components.
        width: Of its prior, in the logarithm. The slope of the prior at the fit is balanced by that of the data there.
        most_shrink: Logarithm of the smallest noise that the digits of the readings allow, over the fitted one.
    """

    n: float
    width: float
    most_shrink: float = policy.MOST_NOISE_SHRINK


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
    size, vectors = torch.linalg.eigh(scaled)
    size = size.clamp(min=0.0)
    square = ((vectors.mT @ (score * prior_sd)[..., None])[..., 0]) ** 2
    if noise is None:
        known: Tensor = 0.5 * (square / (1.0 + size) - torch.log1p(size)).sum(-1) + started
        return known
    # All directions explain no more together than there is. Rounding blows up those that the fit follows: they come last.
    reached = (square / size.clamp(min=TINY)).flip(-1).cumsum(-1).flip(-1).clamp(max=noise.n)
    square = size * (reached - torch.nn.functional.pad(reached[..., 1:], (0, 1)))
    # Over the logarithm of the noise; columns weigh more where it is smaller, and their freedom costs more.
    shrink = torch.linspace(noise.most_shrink, 0.0, N_SHRINKS, dtype=torch.float64)
    grown = torch.exp(-2.0 * shrink)
    size, square = size[..., None, :] * grown[:, None], square[..., None, :] * (grown**2)[:, None]
    explained = 0.5 * (square / (1.0 + size) - torch.log1p(size)).sum(-1) + started * grown
    density = explained - noise.n * shrink - 0.5 * noise.n * (grown - 1.0) - 0.5 * (shrink / noise.width) ** 2
    fitted: Tensor = density.max(-1).values
    return fitted


def log_mean_exp(values: Float[Tensor, " value"]) -> float:
    """Logarithm of the mean of exponentials: evidence averaged over equally likely alternatives."""
    return float(torch.logsumexp(values, 0)) - math.log(len(values))
