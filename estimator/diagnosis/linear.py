"""Evidence for further columns in a linear model with normal noise and priors: the algebra behind symptoms and resolution.

At the maximum of a fit, new columns T can explain of the whitened residual r what the fitted columns J leave. With normal priors on both
the log Bayes factor has a closed form. Where the noise is fitted too, its profile replaces the quadratic.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

MOST_NOISE_SHRINK = (
    -5.0
)  # logarithm of the least noise that more columns may lead to, over the fitted one: a factor of 150

N_SHRINKS = 101  # grid of the logarithm of the noise
COARSE = 5  # of it, one in so many is tried first
TINY = 1e-12  # smallest square of a column, in units of the noise and its prior, that is divided by


@dataclass(frozen=True)
class Projector:
    """Removes from whitened vectors what the fitted parameters can follow, within their priors.

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

    def in_single(self) -> Projector:
        """This projector in single precision; columns are brought to one size first."""
        n = self.factor.shape[-1]
        return Projector(self.basis.float(), torch.eye(n, device=self.factor.device))

    @cached_property
    def basis(self) -> Float[Tensor, "component parameter"]:
        """What the fit can follow of a vector is this times its inner products with this."""
        return self.jacobian @ self.factor

    def gram(
        self, first: Float[Tensor, "component column"], second: Float[Tensor, "component column2"]
    ) -> Float[Tensor, "column column2"]:
        """Inner products of two sets of vectors after projection."""
        followed_first, followed_second = (self.factor.T @ (self.jacobian.T @ v) for v in (first, second))
        return first.T @ second - followed_first.T @ followed_second

    def norms(self, columns: Float[Tensor, "component column"]) -> Float[Tensor, " column"]:
        """Lengths of vectors after projection."""
        followed = self.factor.T @ (self.jacobian.T @ columns)
        square: Tensor = columns.square().sum(0) - followed.square().sum(0)
        return square.clamp(min=0.0).sqrt()

    def rest(self, change: Float[Tensor, "component ..."]) -> Float[Tensor, "component ..."]:
        """The part of one or several changes of the readings that the fit cannot follow."""
        return change - self.jacobian @ (self.factor @ (self.factor.T @ (self.jacobian.T @ change)))


@dataclass(frozen=True)
class FreeNoise:
    """A fitted noise, which shrinks within its prior when further columns explain more.

    Attributes:
        n: Number of components.
        width: Standard deviation of its prior, in the logarithm. At the fit the gradients of prior and likelihood cancel.
        most_shrink: Logarithm of the ratio of the smallest noise that the digits of the readings allow to the fitted one.
        tension: Sum of the squares of the fitted parameters' distances from their priors. Columns relieve it as they explain residuals, but
            it does not grow as the noise shrinks.
    """

    n: float
    width: float
    most_shrink: float = MOST_NOISE_SHRINK
    tension: float = 0.0


def log_bayes_factor(
    gram: Float[Tensor, "*batch column column"],
    score: Float[Tensor, "*batch column"],
    width: Float[Tensor, "*#batch width"],
    noise: FreeNoise | None = None,
) -> Float[Tensor, "*batch width"]:
    """Log Bayes factor of columns with normal priors about zero against none, for each of several widths of these priors.

    Args:
        gram: T^T P T of the projected columns.
        score: T^T r, with r the whitened residual of the fit.
        width: Standard deviation of the coefficients, which all columns of a set share.
        noise: The fitted noise, which shrinks; None where the noise is known.
    References: MacKay, Information Theory, Inference, and Learning Algorithms (2003), section 28.1.
    Examples:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> log_bayes_factor(100.0 * one[None], 60.0 * one, one)  # 6 sigma, prior 10 sigma wide
        tensor([15.5142], dtype=torch.float64)
    """
    own_size, vectors = torch.linalg.eigh(gram)
    own_square = ((vectors.mT @ score[..., None])[..., 0]).square()
    variance = width.square()[..., None]
    size, square = own_size.clamp(min=0.0)[..., None, :] * variance, own_square[..., None, :] * variance
    if noise is None:
        return 0.5 * (square / (1.0 + size) - torch.log1p(size)).sum(-1)
    # Together the directions explain at most residuals and tension. Rounding inflates those that the fit follows, so they come last.
    most = noise.n + noise.tension
    reached = (square / size.clamp(min=TINY)).flip(-1).cumsum(-1).flip(-1).clamp(max=most)
    square = size * (reached - torch.nn.functional.pad(reached[..., 1:], (0, 1)))
    relieved = 0.5 * noise.tension / most * (square / (1.0 + size)).sum(-1)
    square = square * noise.n / most

    def log_density(shrink: Tensor) -> Tensor:
        # At smaller noise the columns weigh more, and so does their Occam factor.
        grown = torch.exp(-2.0 * shrink)
        grown_size, grown_square = (
            size[..., None, :] * grown[..., None],
            square[..., None, :] * grown[..., None] ** 2,
        )
        explained = 0.5 * (grown_square / (1.0 + grown_size) - torch.log1p(grown_size)).sum(-1)
        noisier = noise.n * shrink + 0.5 * noise.n * (grown - 1.0) + 0.5 * (shrink / noise.width) ** 2
        return explained - noisier

    # Profile over the logarithm of the noise, on a coarse grid and on a fine one about its best point.
    shrinks = torch.linspace(noise.most_shrink, 0.0, N_SHRINKS, dtype=torch.float64, device=size.device)
    best = COARSE * log_density(shrinks[::COARSE]).argmax(-1)
    near = (best[..., None] + torch.arange(1 - COARSE, COARSE, device=size.device)).clamp(0, N_SHRINKS - 1)
    return log_density(shrinks[near]).max(-1).values + relieved


def log_mean_exp(values: Float[Tensor, " value"]) -> float:
    """Logarithm of the mean of exponentials: log evidence averaged over equally probable alternatives."""
    return float(torch.logsumexp(values, 0)) - math.log(len(values))
