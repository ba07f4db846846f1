"""What the stops so far say: the fit of those that are not held out, and the linearised model about it.

Both follow from the entries of a journal alone, one after the other, so that an interrupted session goes the same way. The linearised model
of the candidates is renewed whenever the session has grown by a third, that of the readings after every stop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from jaxtyping import Bool, Float

from estimator.effects import EFFECTS
from estimator.inference.levenberg_marquardt import prior_gradient_and_precision
from estimator.inference.likelihood import LogPosterior
from estimator.inference.running import RunningFit
from estimator.model.measurement_model import MeasurementModel
from estimator.planning.candidates import one_row_each
from estimator.planning.causes import with_ordinary
from estimator.planning.goals import Goal
from estimator.planning.information import Expected, draws_of_prior, known_coordinates
from estimator.planning.unseen import Unseen
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.store.growing import observations_of
from estimator.tensors import Tensor, torch

# The estimate and one draw of the running posterior, or two of the prior before the first reading; 8 choose stops that are as good.
N_DRAWS = 2
GROWTH, FEWEST_NEW = 1.3, 2  # of the session, and stops beyond it, until the candidates are linearised again


@dataclass(frozen=True)
class Model:
    """The linearised model of candidates and goals.

    Attributes:
        every: With all ordinary causes.
        alone: With the parameters of the fit only.
        is_asked: Which quantities of causes the stops of a session can exclude.
    """

    every: Expected
    alone: Expected
    is_asked: Bool[Tensor, " cause"]


@dataclass(frozen=True)
class Products:
    """The readings to first order about the estimate, whitened.

    Attributes:
        columns: Derivatives of all readings in parameters and quantities of causes.
        residual: Measured less predicted.
        sigma_T: Noise of each component.
        is_held_out: Of each component.
        prior, gradient: Precision of the priors, and the gradient of their logarithm.
        precision_of_draws: That of priors and readings of the fit at each draw of the candidates' model. With that of the estimate, the
            direction that readings hardly see would be another one at each draw, and every stop would seem to show it.
    """

    columns: Float[Tensor, "component all"]
    residual: Float[Tensor, " component"]
    sigma_T: Float[Tensor, " component"]
    is_held_out: Bool[Tensor, " component"]
    prior: Float[Tensor, "all all"]
    gradient: Float[Tensor, " all"]
    precision_of_draws: Float[Tensor, "draw all all"]

    @cached_property
    def information(self) -> Float[Tensor, "all all"]:
        """What the readings of the fit add to the precision."""
        fitted = self.columns[~self.is_held_out]
        return fitted.T @ fitted

    @cached_property
    def score(self) -> Float[Tensor, " all"]:
        """Gradient of the log posterior of the fit."""
        fitted = ~self.is_held_out
        return self.columns[fitted].T @ self.residual[fitted] + self.gradient


class SoFar:
    """The readings so far, about which all is linear.

    Args:
        rig: As it is fitted.
        stops: Candidates, a row for each sensor.
        goals: What shall be known.
        most_stops: Of the session: what so many stops, evenly spread, do not exclude is taken as stated.
        seed: Of the draws.

    Attributes:
        settings: One row for each candidate.
        coordinates: Of the rig with ordinary causes.
        own: Which of them, noise apart, are parameters of the fit.
        is_usual: Which of the others every device or laboratory has.
        fit: Of all usable stops that are not held out.
        entries: Of the stops.
        rows: Number of the candidate of each.
    """

    def __init__(
        self, rig: Rig, stops: Observations, goals: Sequence[Goal], most_stops: int, seed: int
    ) -> None:
        self.rig, self.stops, self.goals = rig, stops, goals
        self.most_stops, self.seed = most_stops, seed
        self.settings = one_row_each(stops, rig)
        self.rules = MeasurementModel.build(rig, stops).rules
        self.coordinates = Coordinates(with_ordinary(rig, stops, self.rules))
        self._place = torch.tensor([self.coordinates.names.index(name) for name in Coordinates(rig).names])
        self.known = known_coordinates(self.coordinates)
        self.own = torch.isin(self.known, self._place)
        causes = [self.coordinates.names[i].partition("[")[0] for i in self.known[~self.own].tolist()]
        usual = (EFFECTS[name].is_in_every_device or EFFECTS[name].is_everywhere for name in causes)
        self.is_usual = torch.tensor(list(usual), dtype=torch.bool)
        self.restart()

    def restart(self) -> None:
        """Forget all readings."""
        self.fit = RunningFit(self.rig)
        self.entries: list[Mapping[str, Any]] = []
        self.rows: list[int] = []
        self._fitted: Observations | None = None
        self._held_out: Observations | None = None
        self._n_linearised = 0
        self._at = self._beside(draws_of_prior(self.rig, N_DRAWS, self.seed))
        self._model: Model | None = None

    def follow(self, entries: Sequence[Mapping[str, Any]]) -> None:
        """Add what the fit does not hold yet, stop by stop.

        Args:
            entries: Of all stops so far; where they do not continue those before, all is forgotten first.
        """
        if list(entries[: len(self.entries)]) != self.entries:
            self.restart()
        for entry in entries[len(self.entries) :]:
            self.entries.append(entry)
            self.rows.append(self._row(entry))
            self._add(observations_of([entry], self.rig))
            if len(self.entries) >= GROWTH * self._n_linearised + FEWEST_NEW:
                self._n_linearised = len(self.entries)
                while self._fitted is not None and self.fit.can_polish:
                    self.fit.polish(self._fitted)
                self._at, self._model = self._beside(self._draws()), None

    def _row(self, entry: Mapping[str, Any]) -> int:
        """Number of the candidate of a stop: as it was chosen, else the nearest one."""
        if "decision" in entry:
            return int(entry["decision"]["row"])
        here = [*entry["current_A"], *(x for m in self.rig.movers for x in entry["motion"][m.name])]
        columns = torch.cat([self.settings.current_A, *self.settings.motion.values()], dim=1)
        width = (columns.amax(0) - columns.amin(0)).clamp(min=1e-12)
        return int(((columns - columns.new_tensor(here)) / width).norm(dim=-1).argmin())

    def _add(self, readings: Observations) -> None:
        """Add the readings of a stop to the fit, or to those that are held out."""
        usable = readings.rows(readings.is_measured.any(-1)).alone
        if not len(usable):
            return
        if bool(usable.is_validation.any()):
            self._held_out = usable if self._held_out is None else self._held_out.followed_by(usable)
            return
        self._fitted = usable if self._fitted is None else self._fitted.followed_by(usable)
        self.fit.update(self._fitted, len(usable))

    def _draws(self) -> Float[Tensor, "draw own"]:
        """The estimate, and draws of its normal approximation that the prior allows."""
        fit, generator = self.fit, torch.Generator().manual_seed(self.seed)
        root = torch.linalg.cholesky(fit.covariance)
        normal = torch.randn(4 * N_DRAWS, len(root), dtype=torch.float64, generator=generator)
        drawn = fit.vector + normal @ root.mT
        possible = drawn[torch.isfinite(fit.coordinates.log_prior(drawn))]
        return torch.cat((fit.vector[None], possible))[:N_DRAWS]

    def _beside(self, vectors: Float[Tensor, "draw own"]) -> Float[Tensor, "draw all"]:
        """Coordinates of the fit beside causes at their null."""
        result = self.coordinates.start().repeat(len(vectors), 1)
        result[:, self._place] = vectors
        return result

    @property
    def n_fitted(self) -> int:
        """Number of readings of the fit."""
        return 0 if self._fitted is None else len(self._fitted)

    @property
    def n_held_out(self) -> int:
        """Number of readings that are held out."""
        return 0 if self._held_out is None else len(self._held_out)

    @property
    def readings(self) -> Observations | None:
        """All usable readings: those of the fit, then those that are held out; None before the first."""
        if self._fitted is None or self._held_out is None:
            return self._fitted or self._held_out
        return self._fitted.followed_by(self._held_out)

    @property
    def model(self) -> Model:
        """The linearised model of the candidates."""
        if self._model is None:
            every = Expected.of(self.coordinates.rig, self.stops, self.goals, self._at, self.rules)
            own, prior = self.own, every.precision[0]
            all_stops = every.information(torch.arange(every.n_stops))[0] * self.most_stops / every.n_stops
            wanted = [rows[0] for rows in every.wanted]
            at_last = Unseen.of(all_stops, torch.zeros_like(prior[0]), prior, wanted, own)
            is_asked = (at_last.variances(at_last.sd.square(), every.widest) <= 1.0).all(0)
            self._model = Model(every, every.only(own), is_asked)
        return self._model

    def wanted(self) -> list[Float[Tensor, "number all"]]:
        """Rows of the goals at the estimate."""
        at = self._beside(self.fit.vector[None])
        return [goal.rows(self.coordinates, at)[0][:, self.known] for goal in self.goals]

    def products(self) -> Products:
        """The readings to first order about the estimate."""
        at = torch.cat((self._beside(self.fit.vector[None]), self._at))
        gradients, priors = prior_gradient_and_precision(self.coordinates, at)
        gradient, priors = gradients[0, self.known], priors[:, self.known][..., self.known]
        readings = self.readings
        if readings is None:
            nothing = gradient[:0]
            columns = torch.zeros(0, len(gradient), dtype=gradient.dtype)
            return Products(columns, nothing, nothing, nothing.bool(), priors[0], gradient, priors[1:])
        posterior = LogPosterior.by_rules(self.coordinates, readings, self.rules)
        first = posterior.to_first_order(at)
        columns = (first.jacobian_T / first.sigma_T[..., None])[..., self.known]
        residual = (posterior.measured_T - first.predicted_T[0]) / first.sigma_T[0]
        is_held_out = posterior.measured_components(readings.is_validation[:, None].expand(-1, 3))
        fitted = columns[1:, ~is_held_out]
        precisions = priors[1:] + fitted.mT @ fitted
        return Products(columns[0], residual, first.sigma_T[0], is_held_out, priors[0], gradient, precisions)
