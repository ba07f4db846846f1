"""The field where the sensors are: at their elements, where these sit apart, and with what their holders answer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from estimator.derivatives import slopes_in
from estimator.effects.stages import ElementEffect, HolderEffect, RecordEffect
from estimator.effects.use import uses_of
from estimator.field.node_sum import SumMode
from estimator.frames import Transform, in_order, selected
from estimator.model.sources import Sources
from estimator.rig.coordinates import Values
from estimator.rig.rig import Rig
from estimator.rotations import first_derivatives_only
from estimator.tensors import Tensor, torch

MOSTLY_APART = 0.75  # share of readings by sensors with elements apart from which on all are evaluated as such, in one call instead of two


@dataclass(frozen=True)
class FieldAtSensors:
    """The field at the sensors of some readings.

    Attributes:
        sources: What makes the field, at the distinct poses of the readings.
        sensor: Sensor at each distinct pose.
        has_slopes: As of `MeasurementModel`.
    """

    sources: Sources
    sensor: Int[Tensor, " row"]
    has_slopes: bool

    @property
    def rig(self) -> Rig:
        """The rig that is modelled."""
        return self.sources.rig

    @property
    def every_row(self) -> Int[Tensor, " row"]:
        """Numbers of the distinct poses."""
        return torch.arange(len(self.sensor), device=self.sensor.device)

    @property
    def pose_row(self) -> Int[Tensor, " reading"]:
        """Distinct pose of each reading."""
        rows = self.sources.pose_row
        assert rows is not None
        return rows

    def part(self, readings: Int[Tensor, " part"]) -> FieldAtSensors:
        """The field at the sensors of some of the readings."""
        sensor = self.sensor[self.pose_row[readings].unique()]
        return FieldAtSensors(self.sources.part(readings), sensor, self.has_slopes)

    def world_from_sensor(self, rows: Int[Tensor, " rows"], values: Values) -> Transform:
        """Pose of the sensor in the room at distinct poses."""
        if len(self.rig.sensors) == 1:
            return self.sources.world_from_body(self.rig.sensors[0], "sensor", rows, values)
        which = self.sensor[rows]
        for record in uses_of(self.rig, RecordEffect):
            which = record.effect.place_of(which, record.theta(values))
        if which.dim() > 1:  # sensors may be exchanged in some of a batch
            poses = [self.sources.world_from_body(s, "sensor", rows, values) for s in self.rig.sensors]
            return selected(poses, which)
        own = [(which == i).nonzero().flatten() for i in range(len(self.rig.sensors))]
        poses = [
            self.sources.world_from_body(sensor, "sensor", rows[mine], values)
            for sensor, mine in zip(self.rig.sensors, own, strict=True)
        ]
        return in_order(poses, own)

    def field_T(self, values: Values) -> Float[Tensor, "*batch reading 3"]:
        """Field at the sensor's elements, in the sensor's frame."""
        with first_derivatives_only(self.sources.mode is SumMode.FIRST_ORDER):
            return self._field_T(values)

    def _field_T(self, values: Values) -> Float[Tensor, "*batch reading 3"]:
        world_from_sensor = self.world_from_sensor(self.every_row, values)
        field_T = self._without_holders_T(values, world_from_sensor)
        for use in uses_of(self.rig, HolderEffect):
            theta, own = use.theta(values), use.index(self.rig.sensors)
            place_m = use.effect.place_m(theta)[..., None, :] * (self.sensor == own)[:, None]
            there_T = self._field_at(values, world_from_sensor.shifted(place_m))
            is_own = (self.sensor == own)[self.pose_row][:, None]
            field_T = field_T + is_own * use.effect.answer_T(there_T, theta)
        return field_T

    def _without_holders_T(
        self, values: Values, world_from_sensor: Transform
    ) -> Float[Tensor, "*batch reading 3"]:
        if not self._has_elements.any():
            return self._field_at(values, world_from_sensor)
        if self._has_elements.double().mean() >= MOSTLY_APART:
            return self._at_elements(values, world_from_sensor)
        apart, together = self._parts_by_elements
        apart_T = apart.field._at_elements(values, world_from_sensor.rows(apart.rows))
        together_T = together.field._field_at(values, world_from_sensor.rows(together.rows))
        batch = np.broadcast_shapes(apart_T.shape[:-2], together_T.shape[:-2])
        field_T = torch.cat((apart_T.expand(*batch, -1, 3), together_T.expand(*batch, -1, 3)), dim=-2)
        return field_T[..., torch.argsort(torch.cat((apart.readings, together.readings))), :]

    @cached_property
    def _has_elements(self) -> Bool[Tensor, " reading"]:
        """Readings of sensors whose elements sit apart."""
        displaced = [use.index(self.rig.sensors) for use in uses_of(self.rig, ElementEffect)]
        return torch.isin(self.sources.circumstances.sensor, self.sensor.new_tensor(displaced))

    @cached_property
    def _parts_by_elements(self) -> tuple[_Part, _Part]:
        """Readings of sensors whose elements sit apart, and all others."""
        return _Part.of(self, self._has_elements), _Part.of(self, ~self._has_elements)

    def _at_elements(self, values: Values, world_from_sensor: Transform) -> Float[Tensor, "*batch reading 3"]:
        """Field in the sensor's frame, each component where its element sits."""
        elements_m: Tensor | None = None
        for use in uses_of(self.rig, ElementEffect):
            offset_m = use.effect.apply(use.theta(values))[..., None, :]  # batch, element, row, axis
            offset_m = offset_m * (self.sensor == use.index(self.rig.sensors))[:, None]
            elements_m = offset_m if elements_m is None else elements_m + offset_m
        assert elements_m is not None
        rotation, translation_m = world_from_sensor.rotation, world_from_sensor.translation_m
        poses = Transform(rotation[..., None, :, :, :], translation_m[..., None, :, :])
        of_each = {name: value[..., None] if value.dim() else value for name, value in values.items()}
        field_T = self._field_at(of_each, poses.shifted(elements_m))  # batch, element, reading, axis
        field_T = field_T.expand(*field_T.shape[:-3], 3, *field_T.shape[-2:])  # where it is the same for all
        return torch.diagonal(field_T, dim1=-3, dim2=-1)

    def _field_at(self, values: Values, world_from_sensor: Transform) -> Float[Tensor, "*batch reading 3"]:
        """Field in the sensor's frame, at its origin."""
        delivered_A = self.sources.delivered_A(self.sources.circumstances.current_A, values)
        where_m = world_from_sensor.translation_m
        if not (self.has_slopes and where_m.requires_grad):
            return self.sources.field_T(values, delivered_A, world_from_sensor)
        here_m, shift_m = where_m.detach(), where_m.new_zeros(3, requires_grad=True)
        there = Transform(world_from_sensor.rotation, here_m + shift_m)
        field_T = self.sources.field_T(values, delivered_A, there)
        if not field_T.requires_grad:
            return field_T
        slopes = slopes_in(field_T, shift_m)
        moved_m = (where_m - here_m).expand(*where_m.shape[:-2], len(self.sensor), 3)[..., self.pose_row, :]
        return field_T + (slopes @ moved_m[..., None])[..., 0]


@dataclass(frozen=True)
class _Part:
    """Some of the readings.

    Attributes:
        readings: Their numbers.
        rows: Their distinct poses.
        field: At the sensors of them alone.
    """

    readings: Int[Tensor, " part"]
    rows: Int[Tensor, " rows"]
    field: FieldAtSensors

    @classmethod
    def of(cls, field: FieldAtSensors, is_part: Bool[Tensor, " reading"]) -> _Part:
        """The chosen readings, with the field of them alone."""
        readings = is_part.nonzero().flatten()
        return cls(readings, field.pose_row[readings].unique(), field.part(readings))
