"""What may have changed since a calibration, in readings at candidate stops, to first order about it.

A change is a number of the calibration that is another one now, or a quantity of an ordinary cause that was not there. All changes have one
size: their effect on the readings, in the root mean square over the candidates, is a stated share of the field. What the candidates can
tell neither from noise nor from the uncertainty of the calibration, however often they are visited, is left out of a test, and named.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from jaxtyping import Float, Int

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.inference.likelihood import LogPosterior
from estimator.model.measurement_model import MeasurementModel
from estimator.planning.causes import with_ordinary
from estimator.planning.information import known_coordinates
from estimator.readings.observations import Observations
from estimator.recalibration.policy import N_DRAWS
from estimator.rig.coordinates import Coordinates
from estimator.tensors import Tensor, torch

SCATTER = "something without a known pattern"
LEAST_SHARE = 1e-6  # of a prior's width: a loop count that is known has no spread at all
ROUNDING = 1e-9  # of the field: what moves it by less within the width of its prior, such as the turn of a round coil, moves nothing


@dataclass(frozen=True)
class Whitened:
    """Readings to first order about a calibration, over the noise.

    Attributes:
        residual: Measured less predicted.
        columns: Derivatives in all numbers, those of causes too.
        sigma_T: The noise.
        predicted_T: The prediction.
    """

    residual: Float[Tensor, " component"]
    columns: Float[Tensor, "component all"]
    sigma_T: Float[Tensor, " component"]
    predicted_T: Float[Tensor, " component"]


class Expansion:
    """A calibration beside ordinary causes, to first order about the mean of its posterior.

    Args:
        calibration: That may hold.
        stops: Candidates, a row for each sensor.

    Attributes:
        names: Of all numbers but the noise.
        own: Which of them the calibration has.
        covariance: Of these.
        scale: Width of the prior of every number.
    """

    def __init__(self, calibration: Calibration, stops: Observations) -> None:
        rig = calibration.rig
        self._rules = MeasurementModel.build(rig, stops).rules
        self.coordinates = Coordinates(with_ordinary(rig, stops, self._rules))
        self._known = known_coordinates(self.coordinates)
        self.names = [self.coordinates.names[i] for i in self._known.tolist()]
        self.scale = self.coordinates.scale[self._known]
        own = Coordinates(rig)
        values = calibration.draw_values(N_DRAWS)
        draws = own.vector({name: values[name] for name in own.names})
        self._at = self.coordinates.start()
        self._at[[self.coordinates.names.index(name) for name in own.names]] = draws.mean(0)
        known = known_coordinates(own)
        order = {own.names[i]: number for number, i in enumerate(known.tolist())}
        self.own = torch.tensor([number for number, name in enumerate(self.names) if name in order])
        number = torch.tensor([order[self.names[i]] for i in self.own])
        spread = torch.cov(draws[:, known].T) + torch.diag((LEAST_SHARE * own.scale[known]).square())
        self.covariance = spread[number][:, number]

    def whitened(self, readings: Observations) -> Whitened:
        """Readings over the noise.

        Args:
            readings: A row for each sensor.
        """
        posterior = LogPosterior.by_rules(self.coordinates, readings, self._rules)
        first = posterior.to_first_order(self._at)
        columns = (first.jacobian_T / first.sigma_T[:, None])[:, self._known]
        residual = (posterior.measured_T - first.predicted_T) / first.sigma_T
        return Whitened(residual, columns, first.sigma_T, first.predicted_T)

    def words(self, number: int, size: float) -> str:
        """A change in words.

        Args:
            number: Of its column.
            size: In the unit of the column.
        """
        moved, name = self._at.clone(), self.names[number]
        moved[self._known[number]] += size
        before, after = self.coordinates.values(self._at)[name], self.coordinates.values(moved)[name]
        unit = self.coordinates.rig.parameters[name].unit
        return f"{name} by {float(after - before):.2g} {'' if unit == '1' else unit}".rstrip()


@dataclass(frozen=True)
class Changes:
    """Changes that a test asks for.

    Attributes:
        numbers: Their columns.
        names: Of each.
        sizes: Of each, in the unit of its column.
        scatter_T: Unknown scatter of the same size, of each component; 0 where it is not asked for.
        left_out: Names of changes that the candidates do not show.
    """

    numbers: Int[Tensor, " change"]
    names: tuple[str, ...]
    sizes: Float[Tensor, " change"]
    scatter_T: float
    left_out: tuple[str, ...]

    @classmethod
    def of(
        cls, expansion: Expansion, candidates: Whitened, share: float, n_visits: float, misses: float
    ) -> Changes:
        """Changes of a size that candidates show.

        Args:
            expansion: Of the calibration.
            candidates: Their derivatives.
            share: Of the field, that a change is in the root mean square over the candidates.
            n_visits: Most visits of each candidate; fewer than one where not all can be visited.
            misses: Rate of misses that a test shall have.
        """
        field_T = float(candidates.predicted_T.square().mean().sqrt())
        change_T = share * field_T
        effect_T = (candidates.columns * candidates.sigma_T[:, None]).square().mean(0).sqrt()
        sizes = change_T / effect_T.clamp(min=1e-300)
        own, columns = expansion.own, candidates.columns
        information = n_visits * columns.T @ columns
        before = torch.linalg.inv(expansion.covariance) + information[own][:, own]
        beside = information[own]
        certainty = information.diagonal() - (beside * torch.linalg.solve(before, beside)).sum(0)
        does_anything = effect_T * expansion.scale > ROUNDING * field_T
        is_shown = does_anything & (0.5 * sizes.square() * certainty > -math.log(0.5 * misses))
        numbers = is_shown.nonzero().flatten()
        if not len(numbers):
            raise InvalidInput(
                f"a change must be large enough to show at the candidate stops; received {share:.3g} of the field"
            )
        names = tuple(expansion.names[i] for i in numbers.tolist())
        left_out = tuple(expansion.names[i] for i in (~is_shown & does_anything).nonzero().flatten())
        more = 1.0 + (change_T / candidates.sigma_T).square()
        expected = 0.5 * n_visits * float((torch.log(more) - (1.0 - 1.0 / more)).sum())
        if expected > -math.log(0.5 * misses):
            return cls(numbers, names, sizes[numbers], change_T, left_out)
        return cls(numbers, names, sizes[numbers], 0.0, (*left_out, SCATTER))
