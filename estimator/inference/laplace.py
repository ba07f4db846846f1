"""Laplace approximation at the maximum: covariance, evidence, and which directions the data leave open, in words."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.levenberg_marquardt import Optimum
from estimator.rig.coordinates import Coordinates

UNDETERMINED_RATIO = 1.0
SMALLEST_SHARE = 0.15


@dataclass(frozen=True)
class OpenDirection:
    """A direction in which the data say less than the prior.

    Attributes:
        words: The coordinates that make it up, largest share first.
        data_over_prior_sd: Standard deviation from the data alone over the prior's; above 1 the prior rules.
        shares: Prior-scaled components of the direction by coordinate label.
    """

    words: str
    data_over_prior_sd: float
    shares: dict[str, float]


def covariance(precision: Float[Tensor, "*batch n n"]) -> Float[Tensor, "*batch n n"]:
    """Inverse of a precision matrix, scaled first so that units do not cost digits.

    Examples:
        >>> covariance(torch.diag(torch.tensor([4.0, 1e12], dtype=torch.float64))).diagonal().tolist()
        [0.25, 1e-12]
    """
    scale = torch.diagonal(precision, dim1=-2, dim2=-1).clamp(min=1e-300).rsqrt()
    scaled = precision * scale[..., :, None] * scale[..., None, :]
    inverse = torch.linalg.inv(scaled) * scale[..., :, None] * scale[..., None, :]
    symmetric: Tensor = 0.5 * (inverse + inverse.mT)
    return symmetric


def log_evidence(fit: Optimum) -> Float[Tensor, " start"]:
    """Laplace estimate of the log of the integral of the posterior density, up to a common constant."""
    n = fit.precision.shape[-1]
    log_det: Tensor = torch.linalg.slogdet(fit.precision).logabsdet
    return fit.log_posterior + 0.5 * n * math.log(2.0 * math.pi) - 0.5 * log_det


def open_directions(coordinates: Coordinates, fit: Optimum) -> list[OpenDirection]:
    """Directions, in units of the prior, along which the data determine less than the prior does.

    Args:
        coordinates: Meaning of the columns; continuous counts.
        fit: One maximum (the first start is used).
    Returns: The least determined first; empty where the data determine everything.
    References: Eigenvectors of the prior-preconditioned Fisher information; Spantini et al., SIAM J. Sci. Comput. 37, A2451 (2015).
    """
    scale = coordinates.scale[: coordinates.n_continuous]
    information = fit.information[0] * scale[:, None] * scale[None, :]
    eigenvalues, vectors = torch.linalg.eigh(0.5 * (information + information.T))
    found = []
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
        found.append(OpenDirection(_in_words(shares), ratio, shares))
    return found


def _in_words(shares: dict[str, float]) -> str:
    names = list(shares)
    if len(names) == 1:
        return names[0]
    first, *others = names
    parts = [f"{name} {'up' if shares[name] > 0.0 else 'down'}" for name in others]
    return f"{first} up together with {', '.join(parts)}"
