"""What is sampled and maximised: a log density over coordinates, whether or not some parameters are integrated out of it."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.rig.coordinates import Coordinates


class Density(ABC):
    """Log posterior density over coordinates, batched over walkers, starts or hypotheses.

    Attributes:
        coordinates: Meaning of the vector.
        amplitudes: Names of parameters that are integrated out, and drawn afterwards.
    """

    coordinates: Coordinates
    amplitudes: tuple[str, ...] = ()

    @abstractmethod
    def log_likelihood(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch"]:
        """Log probability density of the measured components, averaged over what is integrated out."""

    def at(self, rows: Bool[Tensor, "..."]) -> Density:
        """The density for some rows of a vector."""
        return self

    def __call__(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch"]:
        """Log posterior up to a constant; -inf outside the prior or where the model has no value, never NaN."""
        total = self.coordinates.log_prior(vector)
        possible = torch.isfinite(total)
        if possible.all():
            total = total + self.log_likelihood(vector)
        elif possible.any():
            inside = total[possible] + self.at(possible).log_likelihood(vector[possible])
            total = total.masked_scatter(possible, inside)
        return torch.nan_to_num(total, nan=-math.inf, posinf=-math.inf, neginf=-math.inf)

    def values(self, vector: Float[Tensor, " coordinate"]) -> Mapping[str, Tensor]:
        """Every number of the rig, with the most probable values of what is integrated out."""
        return self.coordinates.values(vector)

    def drawn(
        self, chain: Float[np.ndarray, "step walker coordinate"], seed: int
    ) -> dict[str, Float[np.ndarray, "step walker"]]:
        """One draw of what is integrated out for each draw of the coordinates.

        Args:
            chain: Draws of the coordinates.
            seed: Of the draws.
        """
        return {}
