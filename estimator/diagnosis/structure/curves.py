"""Curves that a residual may follow, and their evidence: columns that depend on one circumstance, for signatures of a residual."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import log_bayes_factor, log_mean_exp
from estimator.field.harmonics import coefficients, gradients


def harmonic_gradients(points: Float[Tensor, "point 3"], degree: int) -> Float[Tensor, "point term 3"]:
    """Gradients of the 2 l + 1 independent harmonic polynomials of one degree; free of divergence and curl.

    Args:
        points: Coordinates, best of order 1.
        degree: l >= 1; 1 gives the three uniform fields.
    Examples:
        >>> harmonic_gradients(torch.zeros(1, 3, dtype=torch.float64), 1).shape
        torch.Size([1, 3, 3])
    """
    return torch.einsum("pti,tu->pui", gradients(points, degree), _orthonormalised(degree).to(points.device))


@lru_cache
def _orthonormalised(degree: int) -> Float[Tensor, "term term"]:
    """Combinations of the solid harmonics that are orthonormal in their coefficients."""
    return torch.linalg.inv(torch.linalg.qr(coefficients(degree)).R)


VANISHING = 1e-9  # of the largest column, in the root mean square: rounding


class Collection:
    """Curves for the residual of one fit; columns that vanish are left out.

    Attributes:
        curves: By what they depend on, in words, whitened columns of alternatives; the mean over components of their summed squares is 1.
    """

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        self.curves: dict[str, list[Float[Tensor, "component column"]]] = {}

    def add(
        self,
        name: str,
        smooth: Float[Tensor, "reading order"],
        vectors: Float[Tensor, "reading 3 direction"],
    ) -> None:
        """Add the products of smooth functions and vectors."""
        self.add_fields(name, torch.einsum("rk,rcv->rkvc", smooth, vectors).flatten(1, 2))

    def add_fields(self, name: str, fields: Float[Tensor, "reading column 3"]) -> None:
        """Add columns given by reading and component."""
        columns = self.fit.posterior.measured_components(fields.movedim(1, 0)) * self.fit.whitening_per_T
        length = columns.norm(dim=-1)
        columns = columns[length > VANISHING * float(length.norm())]
        if len(columns):
            rms = columns.square().sum(0).mean().sqrt()
            self.curves.setdefault(name, []).append(columns.T / rms)

    def evidence(self) -> dict[str, float]:
        """Log Bayes factor by name against noise, averaged over amplitudes and alternatives."""
        return {
            name: log_mean_exp(torch.cat(list(map(self._by_amplitude, alternatives))))
            for name, alternatives in self.curves.items()
        }

    def _by_amplitude(self, columns: Float[Tensor, "component column"]) -> Float[Tensor, " amplitude"]:
        fit, amplitudes = self.fit, columns.new_tensor(policy.AMPLITUDES)
        gram, score = fit.projector.gram(columns, columns), columns.T @ fit.residual
        return log_bayes_factor(gram, score, amplitudes, fit.free_noise)


def axes_of(fit: Fit) -> Float[Tensor, "reading 3 direction"]:
    """The three directions of the sensor at every reading."""
    return torch.eye(3).to(fit.vector).expand(len(fit.observations), 3, 3)


def before(predicted_T: Float[Tensor, "reading 3"], row: Tensor) -> Float[Tensor, "reading 3"]:
    """Predicted field of the reading taken before each one, among the given readings."""
    order = torch.argsort(row)
    previous = torch.empty_like(order)
    previous[order[1:]] = order[:-1]
    previous[order[0]] = order[0]
    return predicted_T[previous]


PLACES: Sequence[tuple[float, float, float]] = (
    (0, 0, -0.3),
    (1.2, 0, -0.6),
    (-1.2, 0, -0.6),
    (0, 1.2, -0.6),
    (0, -1.2, -0.6),
    (0, 0, -2.0),
)  # of dipoles, in radii of a coil


def dipoles(points: Float[Tensor, "reading 3"]) -> Float[Tensor, "reading column 3"]:
    """Fields of dipoles along each axis in and around a coil of radius 1, which move with it."""
    columns = []
    for place in PLACES:
        arm = points - points.new_tensor(place)
        r2 = (arm**2).sum(-1, keepdim=True)
        for axis in range(3):
            moment = torch.eye(3).to(points)[axis]
            columns.append((3.0 * arm[:, axis : axis + 1] * arm - r2 * moment) * r2**-2.5)
    return torch.stack(columns, dim=1)
