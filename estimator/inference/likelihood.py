"""Posterior density of the coordinates given the readings."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.chain import Chain
from estimator.coordinates import Coordinates
from estimator.records import Observations


class LogPosterior:
    """Log posterior density over coordinates, batched over walkers, starts or hypotheses.

    Each measured component is normal about its prediction with the noise of its sensor; the sum runs over squared whitened residuals
    (erratum to eq 2, 3 of the paper).

    Attributes:
        coordinates: Meaning of the vector.
        chain: Predicts the readings.
        measured_T: The measured components, flattened; missing ones left out.
    """

    def __init__(self, coordinates: Coordinates, chain: Chain, observations: Observations) -> None:
        self.coordinates = coordinates
        self.chain = chain
        mask = observations.is_measured
        self._flat = mask.flatten().nonzero().flatten()
        self.measured_T = observations.field_sensor_T.flatten()[self._flat]
        self.sensor = observations.sensor[:, None].expand(-1, 3).flatten()[self._flat]
        self.n_by_sensor = torch.bincount(self.sensor, minlength=len(chain.rig.sensors)).to(torch.float64)

    def predicted(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch component"]:
        """Predicted value of every measured component, in tesla."""
        field = self.chain.predict(self.coordinates.values(vector))
        # Where only noise is free, the field has no batch.
        return field.flatten(-2)[..., self._flat].expand(*vector.shape[:-1], len(self._flat))

    def sigma_T(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch sensor"]:
        """Noise of every sensor, in tesla."""
        values = self.coordinates.values(vector)
        noises = (values[f"{sensor.name}.noise_T"] for sensor in self.chain.rig.sensors)
        return torch.stack([noise.expand(vector.shape[:-1]) for noise in noises], dim=-1)

    def whitened(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch component"]:
        """(measured - predicted) / noise of every measured component."""
        return (self.measured_T - self.predicted(vector)) / self.sigma_T(vector)[..., self.sensor]

    def log_likelihood(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch"]:
        """Log probability density of the measured components."""
        sigma = self.sigma_T(vector)
        chi2 = (self.whitened(vector) ** 2).sum(-1)
        constant = 0.5 * math.log(2.0 * math.pi) * len(self.measured_T)
        return -0.5 * chi2 - (self.n_by_sensor * torch.log(sigma)).sum(-1) - constant

    def __call__(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch"]:
        """Log posterior up to a constant; -inf outside the prior or where the model has no value, never NaN."""
        total = self.coordinates.log_prior(vector)
        possible = torch.isfinite(total)
        if possible.all():
            total = total + self.log_likelihood(vector)
        elif possible.any():
            inside = total[possible] + self.log_likelihood(vector[possible])
            total = total.masked_scatter(possible, inside)
        return torch.nan_to_num(total, nan=-math.inf, posinf=-math.inf, neginf=-math.inf)
