"""Gradient and information of all readings at a point, summed part by part, so that a new reading never waits long."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.inference.likelihood import LogPosterior
from estimator.inference.linearisation import Linearisation

# Predictions of a part of the readings: some 4 ms of a core for one coil, which is what a new reading may have to wait.
GRADIENT_READINGS, LINEARISED_PREDICTIONS = 2_000, 20_000


class Sweep:
    """Gradient of the log likelihood of all readings at a point, and their information if it is asked for.

    Args:
        posterior: Density of the readings.
        point: Where.
        is_linearising: Whether their information is summed too; that takes longer.

    Attributes:
        gradient, information: Sums over the parts so far.
    """

    def __init__(
        self, posterior: LogPosterior, point: Float[Tensor, " coordinate"], is_linearising: bool
    ) -> None:
        n = posterior.coordinates.n
        self.point, self.is_linearising = point, is_linearising
        self.n_readings = len(posterior.model.circumstances)
        self.gradient = torch.zeros(n, dtype=torch.float64)
        self.information = torch.zeros(n, n, dtype=torch.float64)
        self._posterior = posterior
        at_once = max(1, LINEARISED_PREDICTIONS // (2 * n + 1)) if is_linearising else GRADIENT_READINGS
        self._parts = list(torch.arange(self.n_readings).split(at_once))[::-1]

    @property
    def is_done(self) -> bool:
        """Whether all readings have been seen."""
        return not self._parts

    def take_part(self) -> None:
        """Add the next part of the readings."""
        part = self._parts.pop()
        self.add(self._posterior if len(part) == self.n_readings else self._posterior.part(part))

    def add(self, posterior: LogPosterior) -> None:
        """Add readings that are not among those of the density."""
        self.gradient = self.gradient + posterior.gradient(self.point)
        if self.is_linearising:
            linearisation = Linearisation.at(posterior, self.point)
            _, information = linearisation.gradient_and_information(posterior, self.point)
            self.information = self.information + information
