"""Laplace approximation at the maximum: covariance, log evidence, and directions that the data do not determine."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.levenberg_marquardt import Optimum
from estimator.inference.positive_definite import log_determinant
from estimator.rig.coordinates import Coordinates

UNDETERMINED_RATIO = 1.0  # of data to prior standard deviation
SMALLEST_SHARE = 0.15  # of the largest component; smaller ones are not named
TOGETHER = " up together with "  # between the names of a combination
MOST_NAMED = 3  # components beside the largest; the shares have all


@dataclass(frozen=True)
class OpenDirection:
    """A direction along which the prior constrains more than the data.

    Attributes:
        words: The coordinates that make it up, largest share first.
        data_over_prior_sd: Standard deviation from the data alone over that of the prior; above 1 the prior dominates.
        shares: Components of the direction in prior standard deviations, by coordinate label.
    """

    words: str
    data_over_prior_sd: float
    shares: dict[str, float]


def log_evidence(fit: Optimum) -> Float[Tensor, " start"]:
    """Laplace approximation of the log evidence, up to the constant of the log posterior."""
    n = fit.precision.shape[-1]
    return fit.log_posterior + 0.5 * n * math.log(2.0 * math.pi) - 0.5 * log_determinant(fit.precision)


def open_directions(coordinates: Coordinates, fit: Optimum) -> list[OpenDirection]:
    """Directions, in prior standard deviations, along which the data constrain less than the prior.

    Args:
        coordinates: Meaning of the columns; counts are continuous.
        fit: One maximum (the first start is used).
    Returns: Least determined direction first; empty if the data determine everything.
    References: Eigenvectors of the prior-preconditioned Fisher information; Spantini et al., SIAM J. Sci. Comput. 37, A2451 (2015).
    """
    scale = coordinates.scale[: coordinates.n_continuous]
    information = fit.information[0] * scale[:, None] * scale[None, :]
    eigenvalues, vectors = torch.linalg.eigh(0.5 * (information + information.T))
    directions = []
    for eigenvalue, vector in zip(eigenvalues.tolist(), vectors.T, strict=True):
        ratio = 1.0 / math.sqrt(max(eigenvalue, 1e-12))
        if ratio < UNDETERMINED_RATIO:
            break
        weight = vector / vector.abs().max() * torch.sign(vector[vector.abs().argmax()])
        order = sorted(range(len(weight)), key=lambda i: -abs(float(weight[i])))
        shares = {
            coordinates.labels[i]: round(float(weight[i]), 3)
            for i in order
            if abs(float(weight[i])) >= SMALLEST_SHARE
        }
        directions.append(OpenDirection(_in_words(shares), ratio, shares))
    return directions


def _in_words(shares: dict[str, float]) -> str:
    names = list(shares)
    if len(names) == 1:
        return names[0]
    first, *rest = names
    parts = [f"{name} {'up' if shares[name] > 0.0 else 'down'}" for name in rest[:MOST_NAMED]]
    if len(rest) > MOST_NAMED:
        parts.append(f"and {len(rest) - MOST_NAMED} more")
    return f"{first}{TOGETHER}{', '.join(parts)}"
