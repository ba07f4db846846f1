"""A density whose residuals are interpolated between those at a few vectors, so that a draw costs the same for any number of readings.

Many readings leave so little freedom that over the whole posterior each prediction is a polynomial of second degree in the coordinates. Its
residuals are then known from those at some vectors around the maximum, and the sum of their squares from products of these. Draws on which
nothing was fitted compare the result with the density of all readings, which stays in use where the two differ.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.density import Density
from estimator.inference.lattice import CountMixture
from estimator.inference.likelihood import LogPosterior
from estimator.inference.positive_definite import lower_factor
from estimator.side_by_side import each

FEWEST_COMPONENTS = 15_000  # with fewer, sampling takes a few seconds
POINTS_PER_COEFFICIENT = 1.5  # more would average out third powers, which the check finds
REACH = 1.5  # standard deviations of the vectors between which is interpolated, in those of the Laplace approximation
N_CHECKED = 50  # draws of the Laplace approximation
LARGEST_ERROR = 0.05  # of a log density: shifts a mean by less than a twentieth of its standard deviation, as 400 draws do
ENTRIES_AT_ONCE = 2**20  # of the residuals of one part of the readings


def for_sampling(posterior: Density, mixture: CountMixture, seed: int) -> Density:
    """The density that is sampled: interpolated where that saves time and is exact enough, as it was otherwise.

    Args:
        posterior: Density of all readings.
        mixture: Laplace approximation of it.
        seed: Of the vectors between which is interpolated, and of those that check it.
    """
    if not isinstance(posterior, LogPosterior) or not posterior.has_steady_noise:
        return posterior
    if posterior.measured_T.dim() > 1 or len(posterior.measured_T) < FEWEST_COMPONENTS:
        return posterior
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        interpolated = InterpolatedPosterior(posterior, mixture, generator)
        vectors = interpolated.drawn_about(N_CHECKED, 1.0, generator)
        error = interpolated.log_likelihood(vectors) - posterior.log_likelihood(vectors)
    return interpolated if bool((error.abs() <= LARGEST_ERROR).all()) else posterior


class InterpolatedPosterior(Density):
    """The density of many readings by interpolated residuals, at the most probable loop counts; at others the density itself.

    Args:
        posterior: The density; its sensors have the same noise at all readings.
        mixture: Laplace approximation of it.
        generator: Draws the vectors between which is interpolated.
    """

    def __init__(self, posterior: LogPosterior, mixture: CountMixture, generator: torch.Generator) -> None:
        self.coordinates, self._exact = posterior.coordinates, posterior
        best = int(mixture.weight.argmax())
        self._mean, self._counts = mixture.mean[best], mixture.counts[best]
        self._factor = lower_factor(mixture.covariance[best])
        n = len(self._mean)
        n_points = int(POINTS_PER_COEFFICIENT * (1 + n + n * (n + 1) // 2)) + 1
        vectors = self.drawn_about(n_points, REACH, generator)
        fitted = torch.linalg.pinv(self._monomials(vectors))
        self._products_T2 = fitted @ products_of_residuals(posterior, vectors) @ fitted.mT

    def drawn_about(
        self, size: int, reach: float, generator: torch.Generator
    ) -> Float[Tensor, "draw coordinate"]:
        """Draws from the Laplace approximation at the most probable loop counts, widened."""
        white = reach * torch.randn(size, len(self._mean), generator=generator, dtype=self._mean.dtype)
        continuous = self._mean + white.to(self._mean) @ self._factor.mT
        return torch.cat((continuous, self._counts.to(continuous).expand(size, -1)), dim=-1)

    def log_likelihood(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch"]:
        """Log probability density of the measured components."""
        monomials = self._monomials(vector)
        squares_T2 = torch.einsum("...i,sij,...j->...s", monomials, self._products_T2, monomials)
        log_likelihood = self._exact.log_likelihood_of_squares(squares_T2, vector)
        is_other = (vector[..., len(self._mean) :] != self._counts).any(-1)
        if is_other.any():
            log_likelihood[is_other] = self._exact.log_likelihood(vector[is_other])
        return log_likelihood

    def _monomials(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch monomial"]:
        """Products of up to two whitened coordinates."""
        n = len(self._mean)
        shifted = (vector[..., :n] - self._mean)[..., None]
        white = torch.linalg.solve_triangular(self._factor, shifted, upper=False)[..., 0]
        first, second = torch.triu_indices(n, n, device=vector.device)
        return torch.cat(
            (torch.ones_like(white[..., :1]), white, white[..., first] * white[..., second]), dim=-1
        )


def products_of_residuals(
    posterior: LogPosterior, vectors: Float[Tensor, "point coordinate"]
) -> Float[Tensor, "sensor point point"]:
    """Residuals at each vector times those at each other, summed over the components of each sensor; some readings at a time."""
    at_once = max(1, ENTRIES_AT_ONCE // (3 * len(vectors)))
    numbers = torch.arange(len(posterior.model.circumstances), device=vectors.device)

    def of_part(readings: Tensor) -> Tensor:
        part = posterior.part(readings)
        residual_T = part.measured_T - part.predicted(vectors)
        return torch.stack([(residual_T * is_own) @ residual_T.mT for is_own in part.is_of_sensor.mT])

    return torch.stack(list(each(of_part, numbers.split(at_once)))).sum(0)
