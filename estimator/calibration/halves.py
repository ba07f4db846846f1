"""Whether the halves of a session agree with the fit to all of it: by current, by time and by place, and by the response of each sensor.

A fit follows what it can, so a wrong model may leave little. Fits to two halves then find different numbers, which the Chow test sees
without knowing the noise: it asks whether derivatives of the prediction that are switched on in one half explain the residuals.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy import stats
from torch import Tensor

from estimator.inference.levenberg_marquardt import prior_gradient_and_precision
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig

MOST_READINGS = (
    1500  # of which the tests take evenly spaced ones; more would find what is too small to matter
)
MOST_COLUMNS = 300  # of derivatives; coils without a winding have more, and are asked by their response alone
LEAST_IN_HALF = 0.1  # of the readings
RANK_TOLERANCE = 1e-6


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
class _Linear:
    """A fit in its linear model: priors stand as pseudo-readings below the measured components, each in its standard deviation."""

    jacobian: Float[Tensor, "row column"]
    residual: Float[Tensor, " row"]
    predicted_T: Float[Tensor, "reading 3"]
    posterior: LogPosterior
    sigma_T: Float[Tensor, " component"]

    def rows(self, columns_T: Float[Tensor, "column reading 3"]) -> Float[Tensor, "row column"]:
        """Changes of the readings, whitened, with nothing on the pseudo-readings."""
        of_readings = self.posterior.measured_components(columns_T) / self.sigma_T
        return self._below(of_readings.mT)

    def derivatives(self, is_in: Bool[Tensor, " reading"]) -> Float[Tensor, "row column"]:
        """Derivatives of the prediction, switched on for some readings."""
        n = len(self.sigma_T)
        in_half = self.posterior.measured_components(is_in[:, None].expand(-1, 3))
        return self._below(self.jacobian[:n] * in_half[:, None])

    def _below(self, of_readings: Tensor) -> Tensor:
        pseudo = of_readings.new_zeros(len(self.jacobian) - len(of_readings), of_readings.shape[1])
        return torch.cat((of_readings, pseudo))


def disagreements(rig: Rig, observations: Observations, values: Mapping[str, float]) -> list[Disagreement]:
    """What the residuals of a fit depend on, the most striking first; p-values count all tests.

    Args:
        rig: Whose free parameters were fitted.
        observations: Readings of the fit.
        values: Every number of the rig at the best fit; loop counts are whole there, and are asked whether they are.
    References: Chow, Econometrica 28 (1960) 591 (equality of coefficients in two halves).
    """
    if len(observations) > MOST_READINGS:
        index = np.linspace(0, len(observations) - 1, MOST_READINGS).round().astype(int)
        observations = observations.rows(torch.from_numpy(index))
    fit = _linear(rig, observations, values)
    fitted, _ = torch.linalg.qr(fit.jacobian)
    p_values = {words: _p_value(fit, fitted, columns) for words, columns in _tests(rig, observations, fit)}
    adjusted = [Disagreement(words, min(1.0, len(p_values) * p_value)) for words, p_value in p_values.items()]
    return sorted(adjusted, key=lambda each: each.p_value)


def _linear(rig: Rig, observations: Observations, values: Mapping[str, float]) -> _Linear:
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
    return _Linear(jacobian, torch.cat((whitened, pull)), predicted_T, posterior, first.sigma_T)


def _tests(rig: Rig, observations: Observations, fit: _Linear) -> Iterator[tuple[str, Tensor]]:
    """Each test with the changes of the readings that it asks for."""
    for i, sensor in enumerate(rig.sensors):
        is_of_sensor = (observations.sensor == i).to(torch.float64)[:, None]
        shown = fit.predicted_T * is_of_sensor
        columns = [_on_axis(is_of_sensor[:, 0], axis) for axis in range(3)]
        columns += [_on_axis(shown[:, other], axis) for axis in range(3) for other in range(3)]
        words = (
            f"what {sensor.name} shows is turned, stretched or shifted beside the field that the fit predicts"
        )
        yield words, fit.rows(torch.stack(columns))
    if fit.jacobian.shape[1] > MOST_COLUMNS:
        return
    for words, is_in in _halves(rig, observations):
        share = float(is_in.to(torch.float64).mean())
        if LEAST_IN_HALF <= share <= 1.0 - LEAST_IN_HALF:
            constant = torch.stack([_on_axis(is_in.to(torch.float64), axis) for axis in range(3)])
            yield words, torch.cat((fit.derivatives(is_in), fit.rows(constant)), dim=1)


def _halves(rig: Rig, observations: Observations) -> Iterator[tuple[str, Bool[Tensor, " reading"]]]:
    """Halves of the readings, and what is said where fits to the two disagree."""
    current_A = observations.current_A
    yield "readings without current disagree with the others", (current_A == 0.0).all(dim=1)
    for i, coil in enumerate(rig.coils):
        of_coil = current_A[:, i]
        yield f"readings with a negative current in {coil.name} disagree with the others", of_coil < 0.0
        powered = of_coil[of_coil != 0.0].abs()
        if len(powered):
            middle = 0.5 * (powered.min() + powered.max())
            words = f"readings with more than {float(middle):.3g} A in {coil.name} disagree with the others"
            yield words, of_coil.abs() > middle
    yield "the first half of the session disagrees with the second", _above_median(-observations.time_s)
    for mover in rig.movers:
        columns = observations.motion[mover.name]
        for name, column in zip(mover.columns, columns.unbind(1), strict=True):
            if float(column.max() - column.min()) > 0.0:
                yield (
                    f"readings with a large {name} disagree with those with a small one",
                    _above_median(column),
                )
    if len(rig.sensors) > 1:
        for i, sensor in enumerate(rig.sensors):
            yield f"readings of {sensor.name} disagree with those of the others", observations.sensor == i


def _above_median(values: Float[Tensor, " reading"]) -> Bool[Tensor, " reading"]:
    return values > values.median()


def _on_axis(by_reading: Float[Tensor, " reading"], axis: int) -> Float[Tensor, "reading 3"]:
    columns = by_reading.new_zeros(len(by_reading), 3)
    columns[:, axis] = by_reading
    return columns


def _p_value(fit: _Linear, fitted: Tensor, columns: Tensor) -> float:
    """Probability that noise has as large a share of its square along columns, less what the fit follows."""
    size = columns.norm(dim=0)
    columns = columns[:, size > 0.0] / size[size > 0.0]
    left = columns - fitted @ (fitted.mT @ columns)
    basis, singular, _ = torch.linalg.svd(left, full_matrices=False)
    basis = basis[:, singular > RANK_TOLERANCE]
    n_columns, n_left = basis.shape[1], len(fit.residual) - fitted.shape[1]
    if not n_columns or n_left <= n_columns:
        return 1.0
    residual = fit.residual - fitted @ (fitted.mT @ fit.residual)
    share = float((basis.mT @ residual).square().sum() / residual.square().sum())
    return float(stats.beta.sf(min(share, 1.0), 0.5 * n_columns, 0.5 * (n_left - n_columns)))
