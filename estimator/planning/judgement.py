"""What readings contradict: held-out stops against the fit, beyond the noise that repeated stops show.

A fit whose noise is free takes what it cannot follow for noise, and its intervals shrink with the root of the number of readings although
the rest stays. Stops that are visited again show the noise alone. What held-out stops show beyond it does not average out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from scipy.special import fdtrc, ndtri
from torch import Tensor

from estimator.field.winding_shape import Rule
from estimator.inference.likelihood import LogPosterior
from estimator.inference.running import RunningFit
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations

CLEAR_SD = 2.326  # standard deviations of a normal number that is as rare: from here on intervals widen; chance exceeds it at 1 %
CERTAIN_SD = 3.5  # from which on more stops would not help; it is asked after every stop
SMALLEST = 1e-300  # of a probability


@dataclass(frozen=True)
class Misfit:
    """What readings show beyond noise.

    Attributes:
        rest_T: Root mean square of it, in held-out readings or in those of the fit; 0 where chance explains both.
        noise_T: Root mean square of the noise, as repeated stops show it; NaN without any.
        n_held_out: Number of held-out stops.
        n_again: Number of visits beyond the first one of their stop.
        distance_sd: How surprising the larger of both is by an F-test against the noise, in standard deviations of a normal number.
        n_grown: How many times the readings so far are meant.
    """

    rest_T: float
    noise_T: float
    n_held_out: int
    n_again: int
    distance_sd: float = 0.0
    n_grown: float = 1.0

    def factor(self, n_fitted: int, n_unknown: int) -> float:
        """How much wider intervals are than those of noise alone.

        Noise leaves predictions a mean variance of noise^2 times unknowns over components; the rest adds its own square.

        Args:
            n_fitted: Readings of the fit so far.
            n_unknown: Free parameters.

        Examples:
            >>> Misfit(1e-6, 1e-6, 4, 4).factor(100, 3)
            10.05
        """
        if not self.rest_T > 0.0:
            return 1.0
        return math.sqrt(1.0 + 3 * self.n_grown * n_fitted / n_unknown * (self.rest_T / self.noise_T) ** 2)


def misfit_of(
    fit: RunningFit,
    fitted: Observations,
    held_out: Observations,
    rules: Mapping[str, Rule],
    rows: Sequence[int],
    fields_T: Sequence[Tensor],
    n_followed: float,
) -> Misfit:
    """Compare what a fit leaves of its own readings, and of held-out ones, with the noise that repeated stops show.

    Args:
        fit: Of the stops that are not held out.
        fitted: Readings of these.
        held_out: Readings of the others.
        rules: Quadrature rule of each winding.
        rows: Number of the candidate of each stop, in order.
        fields_T: Measured components of each stop.
        n_followed: Numbers that the fit takes from its readings rather than from the prior.
    """
    noise_T2, n_free = _noise_T2(rows, fields_T)
    n_again, n_stops = len(rows) - len(set(rows)), len(held_out.time_s.unique())
    if not n_stops or not n_free:
        return Misfit(0.0, math.nan, n_stops, n_again)
    rest_T2 = distance_sd = 0.0
    for readings, n_lost in ((fitted, n_followed), (held_out, 0.0)):
        model = MeasurementModel.unruled(fit.coordinates.rig, readings).with_rules(dict(rules))
        posterior = LogPosterior(fit.coordinates, model, readings)
        left_T2 = (posterior.measured_T - posterior.predicted(fit.vector)).square()
        n = max(len(left_T2) - n_lost, 1.0)
        if n_lost == 0.0:
            jacobian_T = posterior.jacobian(fit.vector)
            left_T2 = left_T2 - (jacobian_T @ fit.covariance * jacobian_T).sum(-1)
        mean_T2 = float(left_T2.sum()) / n
        chance = float(fdtrc(n, n_free, max(mean_T2, 0.0) / noise_T2))
        each_sd = -float(ndtri(max(chance, SMALLEST)))
        distance_sd = max(distance_sd, each_sd)
        if each_sd > CLEAR_SD:
            rest_T2 = max(rest_T2, mean_T2 - noise_T2)
    return Misfit(math.sqrt(rest_T2), math.sqrt(noise_T2), n_stops, n_again, distance_sd)


def _noise_T2(rows: Sequence[int], fields_T: Sequence[Tensor]) -> tuple[float, int]:
    """Variance within stops that were visited more than once, and its degrees of freedom."""
    total_T2, n_free = 0.0, 0
    for row in set(rows):
        visits_T = torch.stack([field_T for each, field_T in zip(rows, fields_T, strict=True) if each == row])
        measured = visits_T[:, ~visits_T.isnan().any(0)]
        if len(visits_T) > 1:
            total_T2 += float((measured - measured.mean(0)).square().sum())
            n_free += (len(visits_T) - 1) * measured.shape[1]
    return total_T2 / max(n_free, 1), n_free
