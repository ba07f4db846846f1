"""From recorded currents and poses to predicted readings.

One direction: current delivered to each coil -> pose of every coil and sensor -> field of the coils and of the room (`model.sources`)
at the sensor (`model.at_sensors`) -> components as the sensor says them -> components as they are recorded. The rig's effects act at
their stage. One call predicts a whole batch of parameter sets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from jaxtyping import Float, Int

from estimator.effects import stages
from estimator.effects.base import Effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.use import as_meant, uses_of
from estimator.field.grid_map import GridMap
from estimator.field.node_sum import SumMode
from estimator.field.winding_shape import DEFAULT_TOLERANCE, Rule, choose_rule
from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion
from estimator.model.at_sensors import FieldAtSensors
from estimator.model.bodies import columns_of
from estimator.model.coil_field import coil_field, refuse
from estimator.model.sources import Sources
from estimator.readings.observations import Observations
from estimator.rig.bodies import AnyCoil
from estimator.rig.coordinates import Values, nominal_tensors
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch


@dataclass(frozen=True)
class MeasurementModel:
    """One rig and one set of readings, ready to predict these readings at any values of the rig's numbers.

    Attributes:
        sources: What makes the field, at the distinct poses of the readings.
        sensor: Sensor at each distinct pose.
        has_slopes: Whether derivatives by the poses of sensors go through those by the points where they stand, which saves time where
            many numbers move sensors. First derivatives only.
    """

    sources: Sources
    sensor: Int[Tensor, " row"]
    has_slopes: bool = False

    @classmethod
    def build(
        cls, rig: Rig, observations: Observations, tolerance: float = DEFAULT_TOLERANCE
    ) -> MeasurementModel:
        """Set the model up, with quadrature rules for the rig's nominal values.

        Raises:
            InvalidInput: A sensor would stand inside a winding, or where the field of a coil without a winding has no meaning.
        """
        return cls.unruled(rig, observations).choose_rules(
            nominal_tensors(rig, observations.current_A), tolerance
        )

    @classmethod
    def for_values(cls, rig: Rig, observations: Observations, values: Values) -> MeasurementModel:
        """Set the model up with quadrature rules for given values, such as fitted ones.

        A fit may move a winding nearer to a sensor than the nominal values have it, even around it; nothing is refused then, and all loops
        are added up.
        """
        return cls.unruled(rig, observations).choose_rules(values, is_refusing=False, sums_around=True)

    @classmethod
    def unruled(cls, rig: Rig, observations: Observations) -> MeasurementModel:
        """The model before quadrature rules are chosen: `choose_rules`, or `with_rules` of a similar model, completes it."""
        observations = as_meant(rig, observations)
        circumstances = Circumstances(rig, observations)
        columns = columns_of(rig, circumstances)
        motions = [observations.motion[mover.name] for mover in rig.movers]
        key = torch.cat([observations.sensor[:, None].to(torch.float64), *motions, *columns.values()], dim=1)
        distinct, pose_row = torch.unique(key, dim=0, return_inverse=True)
        sensor, distinct = distinct[:, 0].to(torch.int64), distinct.to(observations.dtype)
        flange = {
            mover.name: base_from_motion(mover, distinct[:, 1 + 6 * i : 7 + 6 * i]).sharing_rotation()
            for i, mover in enumerate(rig.movers)
        }
        widths = [values.shape[1] for values in columns.values()]
        parts = distinct[:, 1 + 6 * len(rig.movers) :].split(widths, dim=1) if widths else ()
        columns = dict(zip(columns, parts, strict=True))
        always = {use.place for use in uses_of(rig, stages.CurrentEffect)}  # a coil that is off may leak
        always |= {use.place for use in uses_of(rig, stages.SourceEffect) if use.effect.is_permanent}
        has_current = observations.current_A != 0.0
        exchanges = [use.effect.exchanges_coils for use in uses_of(rig, stages.RecordEffect)]
        exchanges += [use.effect.exchanges_coils for use in uses_of(rig, stages.CurrentEffect)]
        if any(exchanges):
            has_current = has_current.any(-1, keepdim=True).expand_as(has_current)
        powered = {
            coil.name: pose_row[has_current[:, i] | (coil.name in always)].unique()
            for i, coil in enumerate(rig.coils)
        }
        sources = Sources(rig, circumstances, len(distinct), pose_row, flange, columns, powered, {})
        return cls(sources, sensor)

    def with_effects_of(self, rig: Rig) -> MeasurementModel:
        """The model of the same readings, with the same rules, for a rig that has further effects and is the same otherwise."""
        more = set(rig.acting) - set(self.rig.acting)
        kinds = (stages.MotionEffect, stages.MountEffect, stages.RecordEffect, stages.CurrentEffect)
        changed = any(
            use.cause in more
            and (
                isinstance(use.effect, kinds)
                or (isinstance(use.effect, stages.SourceEffect) and use.effect.is_permanent)
            )
            for use in uses_of(rig, Effect)
        )
        if changed:  # the distinct poses, or the coils that have a field, may be others
            return MeasurementModel.unruled(rig, self.circumstances.observations).with_rules(self.rules)
        circumstances = self.circumstances.with_effects_of(rig)
        return replace(self, sources=replace(self.sources, rig=rig, circumstances=circumstances))

    @property
    def rig(self) -> Rig:
        """The rig that is modelled."""
        return self.sources.rig

    @property
    def circumstances(self) -> Circumstances:
        """Circumstances of the readings."""
        return self.sources.circumstances

    @property
    def rules(self) -> Mapping[str, Rule]:
        """Per coil the quadrature rule."""
        return self.sources.rules

    @property
    def powered(self) -> Mapping[str, Int[Tensor, " powered"]]:
        """Distinct poses at which each coil carries current in some reading, or has a field without."""
        return self.sources.powered

    @property
    def every_row(self) -> Int[Tensor, " row"]:
        """Numbers of the distinct poses."""
        return self.at_sensors.every_row

    @cached_property
    def at_sensors(self) -> FieldAtSensors:
        """The field where the sensors are."""
        return FieldAtSensors(self.sources, self.sensor, self.has_slopes)

    @cached_property
    def nominal(self) -> dict[str, Tensor]:
        """Nominal value of every number of the rig, on the device and in the precision of the readings."""
        return nominal_tensors(self.rig, self.circumstances.current_A)

    def alike(self, values: Values) -> Values:
        """Values on the device and in the precision of the readings."""
        like = self.circumstances.current_A
        return {name: value.to(like) for name, value in values.items()}

    @property
    def pose_row(self) -> Int[Tensor, " reading"]:
        """Distinct pose of each reading."""
        return self.at_sensors.pose_row

    def with_rules(self, rules: Mapping[str, Rule]) -> MeasurementModel:
        """This model with given quadrature rules."""
        return replace(self, sources=replace(self.sources, rules=dict(rules)))

    def with_maps(self, maps: Mapping[str, GridMap]) -> MeasurementModel:
        """This model with field maps in the place of some coils' windings."""
        return replace(self, sources=replace(self.sources, maps=dict(maps)))

    def with_mode(self, mode: SumMode) -> MeasurementModel:
        """This model with another way to sum loops."""
        return replace(self, sources=replace(self.sources, mode=mode))

    def with_circumstances(self, circumstances: Circumstances) -> MeasurementModel:
        """This model for other readings at the same settings."""
        return replace(self, sources=replace(self.sources, circumstances=circumstances))

    def part(self, readings: Int[Tensor, " part"]) -> MeasurementModel:
        """The model of some of the readings."""
        at = self.at_sensors.part(readings)
        return replace(self, sources=at.sources, sensor=at.sensor)

    def choose_rules(
        self,
        values: Values,
        tolerance: float = DEFAULT_TOLERANCE,
        is_refusing: bool = True,
        sums_around: bool = False,
    ) -> MeasurementModel:
        """This model with quadrature rules chosen at these values (no batch).

        Args:
            values: Of the rig's numbers.
            tolerance: Of the fields outside windings.
            is_refusing: Refuse sensors inside a winding.
            sums_around: Add up all loops of a winding around a sensor, where no quadrature holds.
        """
        values, rules = self.alike(values), {}
        is_nominal = all(torch.equal(value, self.nominal[name]) for name, value in values.items())
        for coil in self.rig.coils:
            rows = self.powered[coil.name]
            is_idle = not len(rows)  # until an effect makes it carry current
            rows = self.every_row if is_idle else rows
            points_m = self.in_coil(coil, rows, values).translation_m
            field = coil_field(self.rig, coil, values)
            if is_refusing and not is_idle:
                line = self.circumstances.observations.line
                refuse(field.rules(points_m), rows, self.pose_row, line, self.rig.name, is_nominal)
            if field.winding is None:
                continue
            is_outside = ~field.has_none(points_m)
            if sums_around and not bool(is_outside.all()):
                rules[coil.name] = choose_rule(field.winding, points_m, tolerance=0.0)
            elif bool(is_outside.any()):
                rules[coil.name] = choose_rule(field.winding, points_m[is_outside], tolerance)
        return self.with_rules(rules)

    def predict(self, values: Values) -> Float[Tensor, "*batch reading 3"]:
        """Field components each reading should show, in the frame of its sensor, in tesla.

        Args:
            values: Every number of the rig by name, from `Coordinates.values`; a batch where free.
        """
        return self.shown_T(values, self.at_sensor_T(values))

    def shown_T(
        self, values: Values, at_sensor_T: Float[Tensor, "*#batch reading 3"]
    ) -> Float[Tensor, "*batch reading 3"]:
        """Recorded components, given the field at the sensors (`at_sensor_T`)."""
        field_T = self._gain(values)[..., None] * at_sensor_T
        for use in uses_of(self.rig, stages.ReadingEffect):
            changed = use.effect.apply(field_T, use.theta(values), self.circumstances, use.place)
            field_T = use.where_concerned(self.circumstances, changed, field_T)
        for record in uses_of(self.rig, stages.RecordEffect):
            field_T = record.effect.recorded_T(field_T, record.theta(values))
        return field_T

    def sensor_in_coil(
        self, coil: AnyCoil, rows: Int[Tensor, " rows"], values: Values
    ) -> tuple[Float[Tensor, "*batch #rows 3"], Float[Tensor, "*#batch #rows 3 3"]]:
        """Sensor position in the coil frame and the rotation sensor_from_coil, at distinct poses."""
        coil_from_sensor = self.in_coil(coil, rows, values)
        return coil_from_sensor.translation_m, coil_from_sensor.rotation.mT

    def readings_in_coil(
        self, coil: AnyCoil, values: Values
    ) -> tuple[Float[Tensor, "reading 3"], Float[Tensor, "reading 3 3"]]:
        """Sensor position in the coil frame and the rotation coil_from_sensor, for every reading; values have no batch."""
        n = len(self.sensor)
        with torch.no_grad():
            position_m, sensor_from_coil = self.sensor_in_coil(coil, self.every_row, values)
        return position_m.expand(n, 3)[self.pose_row], sensor_from_coil.expand(n, 3, 3)[self.pose_row].mT

    def at_sensor_T(self, values: Values) -> Float[Tensor, "*batch reading 3"]:
        """Field at the sensor's elements, in the sensor's frame."""
        return self.at_sensors.field_T(values)

    def world_from_sensor(self, rows: Int[Tensor, " rows"], values: Values) -> Transform:
        """Pose of the sensor in the room at distinct poses."""
        return self.at_sensors.world_from_sensor(rows, values)

    def _gain(self, values: Values) -> Float[Tensor, "*batch reading"]:
        gains = torch.broadcast_tensors(*(values[f"{s.name}.gain"] for s in self.rig.sensors))
        return torch.stack(gains, dim=-1)[..., self.sensor[self.pose_row]]

    def in_coil(self, coil: AnyCoil, rows: Int[Tensor, " rows"], values: Values) -> Transform:
        """Pose coil_from_sensor at distinct poses; one row where both stay where they are."""
        world_from_coil = self.sources.world_from_body(coil, "coil", rows, values)
        return world_from_coil.inverse() @ self.world_from_sensor(rows, values)
