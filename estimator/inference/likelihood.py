"""Posterior density of the coordinates given the readings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor

from estimator.derivatives import value_and_jacobian, value_and_jacobian_by_paths
from estimator.effects.stages import NoiseEffect, RecordEffect
from estimator.effects.use import as_meant, uses_of
from estimator.field.node_sum import SumMode
from estimator.field.winding_shape import Rule
from estimator.inference.component_noise import ComponentNoise
from estimator.inference.correction_amplitudes import COMPONENTS_AT_ONCE, CorrectionAmplitudes
from estimator.inference.density import Density
from estimator.inference.directions import Directions
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates, Values
from estimator.side_by_side import each, meanwhile

DERIVATIVES_AT_ONCE = 2**22  # entries of one array of derivatives; calculations keep a few dozen such arrays
# Derivatives of one part of the readings: larger parts fall out of a processor's cache and take half as long again.
DERIVATIVES_IN_A_PASS = 2**19
COMPUTED_FROM_READINGS = ("for_jacobian", "_by_points", "is_of_sensor")


class FirstOrder(NamedTuple):
    """Predicted components with their noise, in tesla, and the derivatives of both in the continuous coordinates."""

    predicted_T: Float[Tensor, "*batch component"]
    sigma_T: Float[Tensor, "*batch component"]
    jacobian_T: Float[Tensor, "*batch component continuous"]
    log_sigma_jacobian: Float[Tensor, "*batch component continuous"]


class LogPosterior(Density):
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
        self.coordinates = coordinates.on(observations.device)
        self.model = model
        observations = as_meant(model.rig, observations)
        mask = observations.is_measured
        self._flat = mask.flatten().nonzero().flatten()
        self._is_complete = len(self._flat) == mask.numel()
        self.measured_T = observations.field_sensor_T.flatten()[self._flat]
        self.sensor = observations.sensor[:, None].expand(-1, 3).flatten()[self._flat]
        self.n_by_sensor = torch.bincount(self.sensor, minlength=len(model.rig.sensors)).to(torch.float64)
        self._noise = [
            ComponentNoise.of(use, self.model, self.measured_components)
            for use in uses_of(model.rig, NoiseEffect)
        ]

    @classmethod
    def by_rules(
        cls, coordinates: Coordinates, readings: Observations, rules: Mapping[str, Rule]
    ) -> LogPosterior:
        """The density of readings, with quadrature rules that are known.

        Args:
            coordinates: Of the rig.
            readings: Of the rig; those for validation are no matter of this density.
            rules: Quadrature rule of each winding.
        """
        return cls(
            coordinates, MeasurementModel.unruled(coordinates.rig, readings).with_rules(rules), readings
        )

    def with_rows(self, measured_T: Float[Tensor, "row component"]) -> LogPosterior:
        """The density for vectors whose every row has readings of its own, all taken at the same settings.

        Args:
            measured_T: What `measured_components` leaves of the readings, row by row.
        """
        return self._changed(measured_T=measured_T)

    def at(self, rows: Int[Tensor, "..."] | Bool[Tensor, "..."]) -> LogPosterior:
        """The density for some rows of a vector; the same one where all rows share the readings."""
        return self if self.measured_T.dim() == 1 else self.with_rows(self.measured_T[rows])

    def part(self, readings: Int[Tensor, " part"]) -> LogPosterior:
        """The density of some of the readings, in ascending order.

        Args:
            readings: Their numbers.
        """
        entries = (3 * readings[:, None] + torch.arange(3, device=readings.device)).flatten()
        new_entry = torch.full((3 * len(self.model.circumstances),), -1, device=readings.device)
        new_entry[entries] = torch.arange(len(entries), device=readings.device)
        mine = (new_entry[self._flat] >= 0).nonzero().flatten()
        sensor = self.sensor[mine]
        return self._changed(
            model=self.model.part(readings),
            _flat=new_entry[self._flat[mine]],
            _is_complete=len(mine) == len(entries),
            measured_T=self.measured_T[..., mine],
            sensor=sensor,
            n_by_sensor=torch.bincount(sensor, minlength=len(self.n_by_sensor)).to(torch.float64),
            _noise=[noise.part(mine) for noise in self._noise],
        )

    def _changed(self, **changes: Any) -> LogPosterior:
        """A copy with some attributes changed. What was computed from rig and coordinates alone stays known, all else is forgotten."""
        other = copy(self)
        for computed in COMPUTED_FROM_READINGS:
            other.__dict__.pop(computed, None)
        other.__dict__.update(changes)
        return other

    def measured_components(
        self, field_T: Shaped[Tensor, "*batch reading 3"]
    ) -> Shaped[Tensor, "*batch component"]:
        """Entries that were measured, of anything given by reading and axis."""
        flat = field_T.flatten(-2)
        return flat if self._is_complete else flat[..., self._flat]

    def predicted(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch component"]:
        """Predicted value of every measured component, in tesla."""
        return self._predicted_at(self.coordinates.values(vector), vector.shape[:-1])

    def jacobian(
        self, vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch component continuous"]:
        """Jacobian of the predictions in every continuous coordinate."""
        return self.to_first_order(vector).jacobian_T

    def to_first_order(
        self, vector: Float[Tensor, "*batch coordinate"], columns: Int[Tensor, " column"] | None = None
    ) -> FirstOrder:
        """Predictions, noise, and how both change with every continuous coordinate, or with some of them.

        Args:
            vector: The coordinates.
            columns: Numbers of those that derivatives are taken in; all by default.
        """
        if columns is None:
            columns = torch.arange(self.coordinates.n_continuous, device=vector.device)
        is_amplitude = torch.isin(columns, self._amplitudes.each)
        is_double = self.model.circumstances.observations.dtype is torch.float64  # as differences want
        if vector.shape[:-1].numel() != 1 or not is_double or not is_amplitude.any():
            return self._by_two_passes(vector, columns)
        of_amplitudes = meanwhile(
            lambda: self._amplitudes.jacobian_T(
                self.coordinates, self.model, self.measured_components, vector, columns[is_amplitude]
            )
        )
        others = self._by_two_passes(vector, columns[~is_amplitude])
        shape = (*others.predicted_T.shape, len(columns))
        jacobian_T, log_sigma_jacobian = vector.new_zeros(shape), vector.new_zeros(shape)
        jacobian_T[..., ~is_amplitude] = others.jacobian_T
        jacobian_T[..., is_amplitude] = of_amplitudes()
        log_sigma_jacobian[..., ~is_amplitude] = others.log_sigma_jacobian
        return others._replace(jacobian_T=jacobian_T, log_sigma_jacobian=log_sigma_jacobian)

    def _by_two_passes(
        self, vector: Float[Tensor, "*batch coordinate"], columns: Int[Tensor, " column"]
    ) -> FirstOrder:
        """Predictions, noise and their derivatives by two backward passes (`derivatives`).

        All rows of a batch take the same step, so that one pass serves all. Many readings are taken part by part.
        """
        n, batch = self.coordinates.n_continuous, vector.shape[:-1]
        is_all = torch.equal(columns, torch.arange(n, device=columns.device))
        directions = self._directions if is_all else self._directions.only(columns)
        n_readings = len(self.model.circumstances)
        in_a_pass = DERIVATIVES_IN_A_PASS if vector.device.type == "cpu" else DERIVATIVES_AT_ONCE
        at_once = max(1, in_a_pass // max(1, 3 * len(directions.each) * batch.numel()))
        if n_readings > at_once:
            numbers = torch.arange(n_readings, device=vector.device).split(at_once)
            parts = list(each(lambda part: self.part(part)._by_two_passes(vector, columns), numbers))
            components, jacobians = slice(0, 2), slice(2, 4)
            return FirstOrder(
                *(
                    torch.cat(each, dim=-1)
                    for each in zip(*(part[components] for part in parts), strict=True)
                ),
                *(torch.cat(each, dim=-2) for each in zip(*(part[jacobians] for part in parts), strict=True)),
            )

        def moved(steps: Sequence[Tensor]) -> Tensor:
            each = vector.unbind(-1)
            values = self.coordinates.values_of_each(
                [*(x + step for x, step in zip(each, steps, strict=False)), *each[n:]]
            )
            predicted_T = self._by_points._predicted_at(values, batch)
            return torch.stack((predicted_T, torch.log(self.component_sigma_at_T(values, batch))))

        (predicted_T, log_sigma), along = value_and_jacobian_by_paths(
            moved, vector.new_zeros(n), directions.each, directions.paths
        )
        jacobian = directions.jacobian(along, self.sensor)
        return FirstOrder(predicted_T, torch.exp(log_sigma), *jacobian)

    def gradient(self, vector: Float[Tensor, " coordinate"]) -> Float[Tensor, " coordinate"]:
        """Gradient of the log likelihood in the coordinates, by one backward pass: a third of the time of a Jacobian, or less."""
        with torch.enable_grad():
            point = vector.detach().requires_grad_()
            values, none = self.coordinates.values(point), torch.Size()
            predicted_T = self.for_jacobian._predicted_at(values, none)
            total = self.log_likelihood_of(predicted_T, self.component_sigma_at_T(values, none), point)
            if not total.requires_grad:  # nothing depends on it
                return torch.zeros_like(vector)
            gradient: Tensor = torch.autograd.grad(total, point, materialize_grads=True)[0]
        return gradient

    def log_sigma_jacobian(
        self, vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch component continuous"]:
        """How the logarithm of the noise changes with every continuous coordinate."""
        n, directions = self.coordinates.n_continuous, self._directions

        def moved(step: Tensor) -> Tensor:
            there = torch.cat((vector[..., :n] + step, vector[..., n:]), dim=-1)
            return torch.log(self.component_sigma_T(there))

        _, along = value_and_jacobian(moved, vector.new_zeros(n), directions.each)
        return directions.jacobian(along, self.sensor)

    def _predicted_at(self, values: Values, batch: torch.Size) -> Tensor:
        # Where only noise is free, the field has no batch.
        return self.measured_components(self._predict(values)).expand(*batch, len(self._flat))

    def _predict(self, values: Values) -> Tensor:
        """Predictions in the precision of the readings; what follows is in double precision."""
        if self.model.circumstances.observations.dtype is torch.float64:
            return self.model.predict(values)
        return self.model.predict(self.model.alike(values)).double()

    @cached_property
    def _amplitudes(self) -> CorrectionAmplitudes:
        """Coordinates that predictions are linear in."""
        return CorrectionAmplitudes.of(self.model.rig, self.coordinates)

    @property
    def n_directions(self) -> int:
        """Number of directions that predictions are differentiated in."""
        return len(self._directions.each)

    @cached_property
    def _directions(self) -> Directions:
        """Directions that predictions are differentiated in."""
        return Directions.of(self.model.rig, self.coordinates)

    @cached_property
    def for_jacobian(self) -> LogPosterior:
        """This density, with predictions that have cheap first derivatives, and no second ones."""
        return self._changed(model=self.model.with_mode(SumMode.FIRST_ORDER))

    @cached_property
    def _by_points(self) -> LogPosterior:
        """This density, with derivatives by poses of sensors taken through those by the points where they stand."""
        return self._changed(model=replace(self.for_jacobian.model, has_slopes=True))

    def sigma_T(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch sensor"]:
        """Noise of every sensor, in tesla."""
        return self.sensor_sigma_T(self.coordinates.values(vector), vector.shape[:-1])

    def sensor_sigma_T(self, values: Values, batch: torch.Size) -> Float[Tensor, "*batch sensor"]:
        """Noise of every sensor, in tesla, where the values of all numbers are known already."""
        noises = (values[f"{sensor.name}.noise_T"] for sensor in self.model.rig.sensors)
        return torch.stack([noise.expand(batch) for noise in noises], dim=-1)

    def component_sigma_T(
        self, vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch component"]:
        """Standard deviation of every measured component: noise of its sensor, as it is recorded, and what effects of noise make of it."""
        return self.component_sigma_at_T(self.coordinates.values(vector), vector.shape[:-1])

    def component_sigma_at_T(self, values: Values, batch: torch.Size) -> Float[Tensor, "*batch component"]:
        """Standard deviation of every measured component, where the values of all numbers are known already."""
        sigma_T = self.sensor_sigma_T(values, batch)[..., self.sensor]
        for record in uses_of(self.model.rig, RecordEffect):
            sigma_T = record.effect.recorded_error_T(sigma_T, record.theta(values))
        for noise in self._noise:
            sigma_T = noise.sigma_T(sigma_T, values)
        return sigma_T

    def whitened(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch component"]:
        """(measured - predicted) / noise of every measured component."""
        return (self.measured_T - self.predicted(vector)) / self.component_sigma_T(vector)

    def log_likelihood(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch"]:
        """Log probability density of the measured components, some rows at a time on each core where they would fill the memory."""
        at_once = max(1, COMPONENTS_AT_ONCE // max(1, len(self._flat)))
        if vector.dim() > 1 and len(vector) > at_once:
            parts = torch.arange(len(vector), device=vector.device).split(at_once)
            return torch.cat(list(each(lambda part: self.at(part).log_likelihood(vector[part]), parts)))
        if not self.has_steady_noise:
            return self.log_likelihood_of(self.predicted(vector), self.component_sigma_T(vector), vector)
        squares_T2 = (self.measured_T - self.predicted(vector)).square() @ self.is_of_sensor
        return self.log_likelihood_of_squares(squares_T2, vector)

    @property
    def has_steady_noise(self) -> bool:
        """Whether all components of a sensor have the same noise."""
        return not self._noise and not uses_of(self.model.rig, RecordEffect)

    def log_likelihood_of_squares(
        self, squares_T2: Float[Tensor, "*batch sensor"], vector: Float[Tensor, "*batch coordinate"]
    ) -> Float[Tensor, "*batch"]:
        """Log probability density of the measured components, given the sums of their squared residuals, where noise is steady."""
        sigma_T = self.sigma_T(vector)
        log_density = -0.5 * squares_T2 / sigma_T**2 - self.n_by_sensor * torch.log(sigma_T)
        return log_density.sum(-1) - 0.5 * math.log(2.0 * math.pi) * len(self._flat)

    @cached_property
    def is_of_sensor(self) -> Float[Tensor, "component sensor"]:
        """One where a component is a sensor's, else zero."""
        sensors = torch.arange(len(self.n_by_sensor), device=self.sensor.device)
        return (self.sensor[:, None] == sensors).to(self.measured_T)

    def log_likelihood_of(
        self,
        predicted_T: Float[Tensor, "*batch component"],
        sigma_T: Float[Tensor, "*batch component"],
        vector: Float[Tensor, "*batch coordinate"],
    ) -> Float[Tensor, "*batch"]:
        """Log probability density of the measured components, where predictions and noise are known already.

        Args:
            predicted_T, sigma_T: At the vector.
            vector: Says how readings scatter.
        """
        log_density, _ = self._scatter((self.measured_T - predicted_T) / sigma_T, vector)
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
        share = self.measured_T.new_zeros(len(self._flat))
        ratio = torch.ones_like(share)
        for noise in self._noise:
            share, ratio = noise.contamination(share, ratio, values)
        return share, ratio

    def _scatter(self, whitened: Tensor, vector: Tensor) -> tuple[Tensor, Tensor]:
        """Log density of whitened residuals without its constant, and their weights: normal, contaminated where the rig says so."""
        log_density, weight = -0.5 * whitened**2, torch.ones_like(whitened)
        if self._noise:
            values = self.coordinates.values(vector)
            for noise in self._noise:
                log_density, weight = noise.mixed(log_density, weight, whitened, values)
        return log_density, weight
