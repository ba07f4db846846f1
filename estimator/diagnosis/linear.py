"""Evidence for further columns in a linear model with normal noise and priors: the algebra behind screening and resolution.

At the maximum of a fit, new columns T can explain of the whitened residual r what the fitted columns J leave. With normal priors on both
the log Bayes factor has a closed form. Where the noise is fitted too, its profile replaces the quadratic.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.positive_definite import inner_products

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

    def own_gram(self, columns: Float[Tensor, "component column"]) -> Float[Tensor, "column column"]:
        """Inner products of vectors with each other after projection."""
        followed = self.factor.T @ (self.jacobian.T @ columns)
        return inner_products(columns) - followed.T @ followed

    def norms(self, columns: Float[Tensor, "component column"]) -> Float[Tensor, " column"]:
        """Lengths of vectors after projection."""
        followed = self.factor.T @ (self.jacobian.T @ columns)
        square: Tensor = columns.square().sum(0) - followed.square().sum(0)
        return square.clamp(min=0.0).sqrt()

    def rest(self, change: Float[Tensor, "component ..."]) -> Float[Tensor, "component ..."]:
        """The part of one or several changes of the readings that the fit cannot follow."""
        return change - self.jacobian @ (self.factor @ (self.factor.T @ (self.jacobian.T @ change)))


@dataclass(frozen=True)
class Products:
    """Inner products of the columns of several sets, all that their evidence depends on: readings are touched once for many similar fits.

    Attributes:
        own: With those of the same set.
        followed: With the whitened derivatives of the predictions.
        score: With the whitened residual.
    """

    own: Float[Tensor, "batch column column"]
    followed: Float[Tensor, "batch parameter column"]
    score: Float[Tensor, "batch column"]

    @classmethod
    def of(
        cls,
        columns: Float[Tensor, "batch column component"],
        projector: Projector,
        residual: Float[Tensor, " component"],
    ) -> Products:
        """Inner products of the columns of several sets at a fit, given its projector and whitened residual.

        Args:
            columns: Column after column, so that each lies together in memory and none is copied for a product.
            projector, residual: Of the fit.
        """
        followed = (columns.flatten(0, 1) @ projector.jacobian).unflatten(0, columns.shape[:2]).mT
        return cls(columns @ columns.mT, followed, columns @ residual)

    def without(
        self,
        others: Sequence[int],
        shift: Float[Tensor, " parameter"],
        growth: float,
        are_whitened: bool,
    ) -> Products:
        """These products at the fit without some of its parameters, to first order.

        Args:
            others: Parameters that it still has.
            shift: How it moves all of them.
            growth: Factor by which its noise grows.
            are_whitened: Whether columns are in units of the noise of the fit, or keep their size.
        """
        lighter = 1.0 / growth if are_whitened else 1.0
        score = self.score - (self.followed.mT @ shift[:, None])[..., 0]
        followed = self.followed[:, others]
        return Products(self.own * lighter**2, followed * (lighter / growth), score * (lighter / growth))

    def gram(self, projector: Projector) -> Float[Tensor, "batch column column"]:
        """Inner products after projection."""
        # One product for all sets: many small ones take two to sixteen times as long.
        vectors = self.followed.mT
        followed = (vectors.flatten(0, 1) @ projector.factor).unflatten(0, vectors.shape[:2])
        return self.own - followed @ followed.mT


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
    prior_sd: Float[Tensor, "*batch column"],
    noise: FreeNoise | None = None,
    started: Float[Tensor, "*#batch"] | float = 0.0,
) -> Float[Tensor, "*batch"]:
    """Log Bayes factor of columns with normal priors about zero, against none.

    Args:
        gram: T^T P T of the projected columns.
        score: T^T r, with r the whitened residual of the fit.
        prior_sd: Of the columns' coefficients.
        noise: The fitted noise, which shrinks; None where the noise is known.
        started: Rise in log density at the start about which the columns are taken, where that is not the fit itself.
    References: MacKay, Information Theory, Inference, and Learning Algorithms (2003), section 28.1.
    Examples:
        >>> one = torch.ones(1, dtype=torch.float64)
        >>> round(log_bayes_factor(100.0 * one[None], 60.0 * one, one).item(), 3)  # 6 sigma, prior 10 sigma wide
        15.514
    """
    scaled = gram * prior_sd[..., :, None] * prior_sd[..., None, :]
    return _of_directions(*_directions(scaled, score * prior_sd), noise, started)


def log_bayes_factor_by_width(
    gram: Float[Tensor, "*batch column column"],
    score: Float[Tensor, "*batch column"],
    width: Float[Tensor, "*#batch width"],
    noise: FreeNoise | None = None,
) -> Float[Tensor, "*batch width"]:
    """Log Bayes factor of columns against none, for each of several standard deviations that all columns of a set share.

    The directions of a set are found once.

    Args:
        gram, score, noise: As in `log_bayes_factor`.
        width: Standard deviation of the coefficients.
    """
    size, square = _directions(gram, score)
    variance = width.square()[..., None]
    return _of_directions(size[..., None, :] * variance, square[..., None, :] * variance, noise)


def _directions(
    scaled: Float[Tensor, "*batch column column"], score: Float[Tensor, "*batch column"]
) -> tuple[Float[Tensor, "*batch column"], Float[Tensor, "*batch column"]]:
    """Sizes of independent directions, ascending, and the squares of their scores."""
    size, vectors = torch.linalg.eigh(scaled)
    square: Tensor = ((vectors.mT @ score[..., None])[..., 0]) ** 2
    return size.clamp(min=0.0), square


def _of_directions(
    size: Float[Tensor, "*batch column"],
    square: Float[Tensor, "*batch column"],
    noise: FreeNoise | None,
    started: Float[Tensor, "*#batch"] | float = 0.0,
) -> Float[Tensor, "*batch"]:
    """Log Bayes factor of columns, given their independent directions."""
    if noise is None:
        return 0.5 * (square / (1.0 + size) - torch.log1p(size)).sum(-1) + started
    # Together the directions explain at most residuals and tension. Rounding inflates those that the fit follows, so they come last.
    most = noise.n + noise.tension
    reached = (square / size.clamp(min=TINY)).flip(-1).cumsum(-1).flip(-1).clamp(max=most)
    square = size * (reached - torch.nn.functional.pad(reached[..., 1:], (0, 1)))
    relieved = 0.5 * noise.tension / most * (square / (1.0 + size)).sum(-1)
    square = square * noise.n / most
    rise = torch.as_tensor(started, dtype=torch.float64, device=size.device)[..., None]

    def log_density(shrink: Tensor) -> Tensor:
        # At smaller noise the columns weigh more, and so does their Occam factor.
        grown = torch.exp(-2.0 * shrink)
        grown_size, grown_square = (
            size[..., None, :] * grown[..., None],
            square[..., None, :] * grown[..., None] ** 2,
        )
        explained = 0.5 * (grown_square / (1.0 + grown_size) - torch.log1p(grown_size)).sum(-1) + rise * grown
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
