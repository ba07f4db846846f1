"""Posterior density of the coordinates given the readings."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor
from torch.func import jacfwd

from estimator.effects.base import Effect
from estimator.effects.stages import (
    ElementEffect,
    MotionEffect,
    MountEffect,
    NoiseEffect,
    RecordEffect,
    WindingEffect,
)
from estimator.effects.use import Use, uses_of
from estimator.field.node_sum import SumMode
from estimator.model.measurement_model import MeasurementModel, NominalPrediction
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates, Values


class LogPosterior:
    """Log posterior density over coordinates, batched over walkers, starts or hypotheses.

    Each measured component is normal about its prediction with the noise of its sensor, unless the rig has effects of noise; the sum
    runs over squared whitened residuals (erratum to eq 2, 3 of the paper).

    Attributes:
        coordinates: Meaning of the vector.
        model: Predicts the readings.
        measured_T: The measured components, flattened; missing ones left out. With a leading axis, one row of readings for each row of
            the vector: many sessions of the same settings at once.
    """

    def __init__(self, coordinates: Coordinates, model: MeasurementModel, observations: Observations) -> None:
        self.coordinates = coordinates
        self.model = model
        mask = observations.is_measured
        self._flat = mask.flatten().nonzero().flatten()
        self.measured_T = observations.field_sensor_T.flatten()[self._flat]
        self.sensor = observations.sensor[:, None].expand(-1, 3).flatten()[self._flat]
        self.n_by_sensor = torch.bincount(self.sensor, minlength=len(model.rig.sensors)).to(torch.float64)
        self._noise = [_Noise.of(use, self) for use in uses_of(model.rig, NoiseEffect)]

    def with_rows(self, measured_T: Float[Tensor, "row component"]) -> LogPosterior:
        """The density for vectors whose every row has readings of its own, all taken at the same settings.

        Args:
            measured_T: What `measured_components` leaves of the readings, row by row.
        """
        other = copy(self)
        other.measured_T = measured_T
        return other

    def at(self, rows: Int[Tensor, "..."] | Bool[Tensor, "..."]) -> LogPosterior:
        """The density for some rows of a vector; the same one where all rows share the readings."""
        return self if self.measured_T.dim() == 1 else self.with_rows(self.measured_T[rows])

    def measured_components(
        self, field_T: Shaped[Tensor, "*batch reading 3"]
    ) -> Shaped[Tensor, "*batch component"]:
        """Of anything given by reading and axis, the entries that were measured."""
        return field_T.flatten(-2)[..., self._flat]

    def predicted(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch component"]:
        """Predicted value of every measured component, in tesla."""
        return self._predicted_at(self.coordinates.values(vector), vector.shape[:-1])

    def jacobian(
        self, vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch component continuous"]:
        """Jacobian of the predictions in every continuous coordinate.

        All rows of a batch take the same step, so that one forward pass serves all. Coordinates that do not move the field, such as a gain
        or a noise, are differentiated apart from those that do; otherwise their derivatives would be carried through the field.
        """
        total = self._zero_jacobian(vector)
        for is_dear in (True, False):
            columns = self._columns(is_dear)
            if len(columns):
                total[..., columns] = self._jacobian_along(vector, columns, is_dear)
        return total

    def log_sigma_jacobian(
        self, vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch component continuous"]:
        """Jacobian of the logarithm of every component's noise in every continuous coordinate."""
        total, columns = self._zero_jacobian(vector), self._columns(is_dear=False)

        def moved(step: Tensor) -> Tensor:
            return torch.log(
                self.component_sigma_T(vector.index_add(-1, columns, step.expand(*vector.shape[:-1], -1)))
            )

        if len(columns):
            total[..., columns] = jacfwd(moved)(torch.zeros(len(columns), dtype=vector.dtype))
        return total

    def _jacobian_along(self, vector: Tensor, columns: Tensor, is_dear: bool) -> Tensor:
        """Jacobian of the predictions in some coordinates, with all numbers of the other kind held fixed."""

        def moved(step: Tensor) -> Tensor:
            there = vector.index_add(-1, columns, step.expand(*vector.shape[:-1], -1))
            values = {
                name: value if self._is_dear(name) == is_dear else value.detach()
                for name, value in self.coordinates.values(there).items()
            }
            return self._for_jacobian._predicted_at(values, vector.shape[:-1])

        jacobian: Tensor = jacfwd(moved)(torch.zeros(len(columns), dtype=vector.dtype))
        return jacobian

    def _zero_jacobian(self, vector: Tensor) -> Tensor:
        return torch.zeros(
            *vector.shape[:-1], len(self._flat), self.coordinates.n_continuous, dtype=vector.dtype
        )

    def _columns(self, is_dear: bool) -> Int[Tensor, " column"]:
        """Which coordinates move the field, or which do not; whole numbers are left out."""
        names = self.coordinates.names[: self.coordinates.n_continuous]
        return torch.tensor(
            [i for i, name in enumerate(names) if self._is_dear(name) == is_dear], dtype=torch.int64
        )

    def _predicted_at(self, values: Values, batch: torch.Size) -> Tensor:
        # Where only noise is free, the field has no batch.
        return self.measured_components(self.model.predict(values)).expand(*batch, len(self._flat))

    def _is_dear(self, name: str) -> bool:
        """Whether a number changes where a winding's field is taken, or the winding; one that is tied counts as the one it follows."""
        while (tie := self.model.rig.parameters[name].tie) is not None:
            name = tie.to
        return not (name.endswith((".noise_T", ".gain", ".current_gain")) or name.startswith(self._cheap))

    @cached_property
    def _cheap(self) -> tuple[str, ...]:
        """Prefixes of the numbers of effects that act on the field, the current or the reading."""
        geometry = (MotionEffect, MountEffect, ElementEffect, WindingEffect)
        uses = uses_of(self.model.rig, Effect)
        return tuple(f"{use.label}." for use in uses if not isinstance(use.effect, geometry))

    @cached_property
    def _for_jacobian(self) -> LogPosterior:
        """The same density with predictions that have cheap first derivatives, and no second ones."""
        other = copy(self)
        other.model = self.model.with_mode(SumMode.FIRST_ORDER)
        return other

    def sigma_T(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch sensor"]:
        """Noise of every sensor, in tesla."""
        values = self.coordinates.values(vector)
        noises = (values[f"{sensor.name}.noise_T"] for sensor in self.model.rig.sensors)
        return torch.stack([noise.expand(vector.shape[:-1]) for noise in noises], dim=-1)

    def component_sigma_T(
        self, vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch component"]:
        """Standard deviation of every measured component: noise of its sensor, as it is recorded, and what effects of noise make of it."""
        sigma_T = self.sigma_T(vector)[..., self.sensor]
        values = self.coordinates.values(vector)
        for record in uses_of(self.model.rig, RecordEffect):
            sigma_T = record.effect.recorded_error_T(sigma_T, record.theta(values))
        for noise in self._noise:
            wider_T = noise.use.effect.sigma_T(sigma_T, noise.exposure, noise.use.theta(values))
            sigma_T = noise.where_concerned(wider_T, sigma_T)
        return sigma_T

    def whitened(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch component"]:
        """(measured - predicted) / noise of every measured component."""
        return (self.measured_T - self.predicted(vector)) / self.component_sigma_T(vector)

    def log_likelihood(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch"]:
        """Log probability density of the measured components."""
        sigma_T = self.component_sigma_T(vector)
        whitened = (self.measured_T - self.predicted(vector)) / sigma_T
        log_density, _ = self._scatter(whitened, vector)
        constant = 0.5 * math.log(2.0 * math.pi) * len(self._flat)
        return (log_density - torch.log(sigma_T)).sum(-1) - constant

    def component_log_density(
        self, vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch component"]:
        """Log probability density of each measured component."""
        log_density, _ = self._scatter(self.whitened(vector), vector)
        return log_density - torch.log(self.component_sigma_T(vector)) - 0.5 * math.log(2.0 * math.pi)

    def weight(
        self, whitened: Float[Tensor, "*batch component"], vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch component"]:
        """How much each component counts: 1, or less where it is probably an outlier."""
        return self._scatter(whitened, vector)[1]

    def contamination(
        self, values: Values
    ) -> tuple[Float[Tensor, "*batch component"], Float[Tensor, "*batch component"]]:
        """Share of wider scatter in every component, and how many times wider it is; 0 and 1 where all scatter normally."""
        share = torch.zeros(len(self._flat), dtype=self.measured_T.dtype)
        ratio = torch.ones_like(share)
        for noise in self._noise:
            contamination = noise.use.effect.contamination(noise.use.theta(values))
            if contamination is not None:
                share = noise.where_concerned(contamination[0][..., None], share)
                ratio = noise.where_concerned(contamination[1][..., None], ratio)
        return share, ratio

    def _scatter(self, whitened: Tensor, vector: Tensor) -> tuple[Tensor, Tensor]:
        """Log density of whitened residuals without its constant, and their weights: normal, contaminated where the rig says so."""
        log_density, weight = -0.5 * whitened**2, torch.ones_like(whitened)
        for noise in self._noise:
            contamination = noise.use.effect.contamination(noise.use.theta(self.coordinates.values(vector)))
            if contamination is None:
                continue
            share, ratio = (number[..., None] for number in contamination)
            good = torch.log1p(-share) + log_density
            bad = torch.log(share) - torch.log(ratio) - 0.5 * (whitened / ratio) ** 2
            mixed = torch.logaddexp(good, bad)
            is_good = torch.exp(good - mixed)
            log_density = noise.where_concerned(mixed, log_density)
            weight = noise.where_concerned(is_good + (1.0 - is_good) / ratio**2, weight)
        return log_density, weight

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


@dataclass(frozen=True)
class _Noise:
    """An effect of noise in the measured components.

    Attributes:
        use: The effect and the place that has it.
        concerned: Components that it concerns; None stands for all.
        exposure: What their scatter depends on besides the effect's quantities.
    """

    use: Use[NoiseEffect]
    concerned: Bool[Tensor, " component"] | None
    exposure: Float[Tensor, " component"]

    @classmethod
    def of(cls, use: Use[NoiseEffect], posterior: LogPosterior) -> _Noise:
        """What it concerns of the readings of a density."""
        readings = use.concerned(posterior.model.circumstances)
        concerned = (
            None if readings is None else posterior.measured_components(readings[:, None].expand(-1, 3))
        )
        exposure = use.effect.exposure(NominalPrediction(posterior.model), use.place)
        return cls(use, concerned, posterior.measured_components(exposure))

    def where_concerned(self, changed: Tensor, unchanged: Tensor) -> Tensor:
        """Changed components where it concerns them."""
        return changed if self.concerned is None else torch.where(self.concerned, changed, unchanged)
