"""A fit in its linear model, and how probable noise alone makes what its residuals have along some changes of the readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.special import betaincc
from torch import Tensor

from estimator.inference.levenberg_marquardt import prior_gradient_and_precision
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig

# The tests take evenly spaced readings; more would find what is too small to matter
MOST_READINGS = 1500
RANK_TOLERANCE = 1e-10  # of the square of a column, less what the fit follows


@dataclass(frozen=True)
class Disagreement:
    """Residuals that depend on something.

    Attributes:
        words: On what, in a sentence.
        p_value: Probability that noise alone leaves as much in any of the tests.
    """

    words: str
    p_value: float


@dataclass(frozen=True)
class LinearFit:
    """A fit in its linear model: priors stand as pseudo-readings below the measured components, each in its standard deviation.

    Attributes:
        values: Every number of the rig.
        jacobian: Of readings and priors.
        residual: Of readings and priors.
        predicted_T: What the model predicts.
        posterior: Density of the readings.
        sigma_T: Noise of each measured component.
    """

    values: Mapping[str, Tensor]
    jacobian: Float[Tensor, "row column"]
    residual: Float[Tensor, " row"]
    predicted_T: Float[Tensor, "reading 3"]
    posterior: LogPosterior
    sigma_T: Float[Tensor, " component"]

    @classmethod
    def of(cls, rig: Rig, observations: Observations, values: Mapping[str, float]) -> LinearFit:
        """The linear model about the best fit.

        Args:
            rig: Whose free parameters were fitted.
            observations: Readings of the fit; evenly spaced ones count where there are many.
            values: Every number of the rig; loop counts are whole there, and are asked whether they are.
        """
        if len(observations) > MOST_READINGS:
            index = np.linspace(0, len(observations) - 1, MOST_READINGS).round().astype(int)
            observations = observations.rows(torch.from_numpy(index))
        coordinates = Coordinates(rig)
        model = MeasurementModel.build(rig, observations)
        as_tensors = {name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()}
        model = model.choose_rules(as_tensors)
        posterior = LogPosterior(coordinates, model, observations)
        vector = coordinates.vector(as_tensors)
        with torch.no_grad():
            first = posterior.to_first_order(vector)
            predicted_T = model.predict(as_tensors)
        gradient, precision = prior_gradient_and_precision(coordinates, vector[None])
        root = torch.linalg.cholesky(precision[0]).mT
        pull = torch.linalg.solve_triangular(root.mT, gradient[0][:, None], upper=False)[:, 0]
        whitened = (posterior.measured_T - first.predicted_T) / first.sigma_T
        jacobian = torch.cat((first.jacobian_T / first.sigma_T[:, None], root))
        residual = torch.cat((whitened, pull))
        return cls(as_tensors, jacobian, residual, predicted_T, posterior, first.sigma_T)

    def rows(self, columns_T: Float[Tensor, "*start column reading 3"]) -> Float[Tensor, "*start row column"]:
        """Changes of the readings, whitened, with nothing on the pseudo-readings."""
        of_readings = self.posterior.measured_components(columns_T) / self.sigma_T
        return self._below(of_readings.mT)

    def derivatives(self, is_in: Bool[Tensor, " reading"]) -> Float[Tensor, "row column"]:
        """Derivatives of the prediction, switched on for some readings."""
        n = len(self.sigma_T)
        in_half = self.posterior.measured_components(is_in[:, None].expand(-1, 3))
        return self._below(self.jacobian[:n] * in_half[:, None])

    def _below(self, of_readings: Float[Tensor, "*start component column"]) -> Tensor:
        *start, n, columns = of_readings.shape
        pseudo = of_readings.new_zeros(*start, len(self.jacobian) - n, columns)
        return torch.cat((of_readings, pseudo), dim=-2)

    @cached_property
    def _followed(self) -> Float[Tensor, "row column"]:
        """Orthonormal changes that the fit follows."""
        return torch.linalg.qr(self.jacobian).Q

    @cached_property
    def _left(self) -> Float[Tensor, " row"]:
        return self.residual - self._followed @ (self._followed.mT @ self.residual)

    @property
    def left_square(self) -> float:
        """Square of what the fit leaves, in units of the noise."""
        return float(self._left.square().sum())

    def p_values(self, columns: Float[Tensor, "start row column"]) -> np.ndarray:
        """Probability that noise has as large a share of its square along columns, less what the fit follows, for each start."""
        size = columns.norm(dim=-2, keepdim=True)
        columns = columns / size.clamp(min=torch.finfo(size.dtype).tiny)
        columns = columns - self._followed @ (self._followed.mT @ columns)
        square, axes = torch.linalg.eigh(columns.mT @ columns)
        along = (axes.mT @ (columns.mT @ self._left)[..., None])[..., 0]
        is_left = square > RANK_TOLERANCE
        share = torch.where(is_left, along.square() / square, 0.0).sum(-1) / self.left_square
        n_columns = is_left.sum(-1).numpy()
        n_left = len(self.residual) - self._followed.shape[1]
        can_tell = (n_columns > 0) & (n_columns < n_left)
        p_values = np.ones(len(columns))
        half, rest = 0.5 * n_columns[can_tell], 0.5 * (n_left - n_columns[can_tell])
        p_values[can_tell] = betaincc(half, rest, share.numpy().clip(0.0, 1.0)[can_tell])
        return p_values
