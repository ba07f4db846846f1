"""From commanded currents and poses to predicted readings.

The measurement model runs in one direction: current delivered to each coil -> pose of every coil and sensor -> field of the coils and of
the room at the sensor -> components as the sensor says them. The rig's effects act at their stage. One call predicts a whole batch of
parameter sets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.func import jacfwd

from estimator.effects.base import (
    CurrentEffect,
    ElementEffect,
    Kind,
    PerAmpere,
    ReadingEffect,
    RoomEffect,
    SourceEffect,
    Theta,
    WindingEffect,
    WindingMagnetisation,
)
from estimator.effects.circumstances import Circumstances
from estimator.effects.record import UnitError
from estimator.effects.use import Use, uses_of
from estimator.errors import InvalidInput
from estimator.field.coil import coil_field_per_ampere
from estimator.field.first_order import with_cheap_slope
from estimator.field.magnetised import field_of_rings
from estimator.field.node_sum import SumMode
from estimator.field.winding import (
    DEFAULT_TOLERANCE,
    Rule,
    Winding,
    choose_rule,
    distance_to_winding,
)
from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion
from estimator.model.bodies import WINDING_KEYS, columns_of, winding_of, world_from_body
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Values
from estimator.rig.rig import Body, Coil, Rig

# Of points in a coil's frame, as `SourceEffect.apply`.
SourceField = Callable[[Tensor, Winding, Rule, Theta], Tensor]


@dataclass(frozen=True)
class MeasurementModel:
    """The measurement model of one rig over one set of readings.

    Readings that share a pose share its geometry: `place` maps each reading to a row of distinct poses, so that +I, -I and repeats at
    one place cost one field evaluation.

    Attributes:
        rig: What is modelled.
        circumstances: Circumstances of the readings.
        place: Row of distinct poses that each reading stands at.
        sensor: Sensor of each distinct pose.
        flange: Per mover base_from_flange (or the displacement) of each distinct pose; one rotation for all where it is the same.
        columns: Per effect that moves bodies, what else it depends on, by distinct pose.
        powered: Per coil the distinct poses where it ever carries current.
        rules: Per coil the quadrature rule.
        mode: How loops are summed: compiled for long sampling, to first order for fits.
    """

    rig: Rig
    circumstances: Circumstances
    place: Int[Tensor, " reading"]
    sensor: Int[Tensor, " place"]
    flange: dict[str, Transform]
    columns: dict[str, Float[Tensor, "place column"]]
    powered: dict[str, Int[Tensor, " rows"]]
    rules: dict[str, Rule]
    mode: SumMode = SumMode.EAGER

    @classmethod
    def build(
        cls, rig: Rig, observations: Observations, tolerance: float = DEFAULT_TOLERANCE
    ) -> MeasurementModel:
        """Set the model up at the rig's nominal values.

        Raises:
            InvalidInput: A sensor would stand inside a winding.
        """
        nominal = {k: torch.tensor(v, dtype=torch.float64) for k, v in rig.nominal_values().items()}
        return cls.unruled(rig, observations).with_rules(nominal, tolerance)

    @classmethod
    def unruled(cls, rig: Rig, observations: Observations) -> MeasurementModel:
        """The model before quadrature rules are chosen; `with_rules` or `rules` of a similar model complete it."""
        circumstances = Circumstances(rig, observations)
        columns = columns_of(rig, circumstances)
        motions = [observations.motion[mover.name] for mover in rig.movers]
        key = torch.cat([observations.sensor[:, None].to(torch.float64), *motions, *columns.values()], dim=1)
        distinct, place = torch.unique(key, dim=0, return_inverse=True)
        flange = {
            mover.name: _sharing_rotation(base_from_motion(mover, distinct[:, 1 + 6 * i : 7 + 6 * i]))
            for i, mover in enumerate(rig.movers)
        }
        widths = [values.shape[1] for values in columns.values()]
        parts = distinct[:, 1 + 6 * len(rig.movers) :].split(widths, dim=1) if widths else ()
        columns = dict(zip(columns, parts, strict=True))
        leaking = {use.place for use in uses_of(rig, CurrentEffect)}
        powered = {
            coil.name: place[(observations.current_A[:, i] != 0.0) | (coil.name in leaking)].unique()
            for i, coil in enumerate(rig.coils)
        }
        sensor = distinct[:, 0].to(torch.int64)
        return cls(rig, circumstances, place, sensor, flange, columns, powered, {})

    def with_rules(self, values: Values, tolerance: float = DEFAULT_TOLERANCE) -> MeasurementModel:
        """The same model with quadrature rules chosen at these values (no batch)."""
        rules = {}
        for coil in self.rig.coils:
            rows = self.powered[coil.name]
            is_idle = not len(rows)  # until an effect makes it carry current
            rows = torch.arange(len(self.sensor)) if is_idle else rows
            points_m = self._in_coil(coil, rows, values).translation_m
            winding = winding_of(self.rig, coil, values)
            if is_idle:
                points_m = points_m[distance_to_winding(points_m, winding) > 0.0]
            else:
                self._refuse_inside(coil, rows, points_m, winding)
            if len(points_m):
                rules[coil.name] = choose_rule(winding, points_m, tolerance)
        return replace(self, rules=rules)

    def predict(self, values: Values) -> Float[Tensor, "*batch reading 3"]:
        """Field components each reading should show, in the frame of its sensor, in tesla.

        Args:
            values: Every number of the rig by name, from `Coordinates.values`; a batch where free.
        """
        field_T = self._true_field(values)
        for use in uses_of(self.rig, ReadingEffect):
            changed = use.effect.apply(field_T, use.theta(values), self.circumstances, use.place)
            field_T = torch.where(self._is_of(use)[:, None], changed, field_T)
        return field_T

    def gradient_T_per_m(self, mover: str) -> Float[Tensor, "reading 3 3"]:
        """Change of each component per displacement of a mover along its axes, at the rig's nominal values."""
        values = {k: torch.tensor(v, dtype=torch.float64) for k, v in self.rig.nominal_values().items()}
        poses = self.flange[mover]

        def moved(shift_m: Tensor) -> Tensor:
            displaced = Transform(poses.rotation, poses.translation_m + shift_m)
            return replace(self, flange={**self.flange, mover: displaced}).predict(values)

        slope: Tensor = jacfwd(moved)(torch.zeros(3, dtype=torch.float64))
        return slope

    def _is_of(self, use: Use[ReadingEffect]) -> Bool[Tensor, " reading"]:
        """Readings that an effect concerns: those of its sensor, or all."""
        if use.effect.kind is Kind.RECORD:
            return torch.ones(len(self.circumstances), dtype=torch.bool)
        return self.circumstances.sensor == use.index(self.rig.sensors)

    def loop_evaluations(self) -> int:
        """Loop fields that one prediction of one parameter set costs."""
        return sum(len(self.powered[n]) * r.axial_nodes * r.radial_nodes for n, r in self.rules.items())

    def delivered_A(self, values: Values) -> Float[Tensor, "*batch reading coil"]:
        """Currents that the supplies really deliver."""
        gains = torch.stack(
            torch.broadcast_tensors(*(values[f"{coil.name}.current_gain"] for coil in self.rig.coils)), dim=-1
        )
        current_A = gains[..., None, :] * self.circumstances.current_A
        for record in uses_of(self.rig, UnitError):
            current_A = record.effect.current_A(current_A, record.theta(values))
        for use in uses_of(self.rig, CurrentEffect):
            current_A = use.effect.apply(
                current_A, use.theta(values), self.circumstances, use.index(self.rig.coils)
            )
        return current_A

    def _true_field(self, values: Values) -> Float[Tensor, "*batch reading 3"]:
        """Field at the sensor's elements, in the sensor's frame."""
        gain = self._gain(values)[..., None]
        displaced = [use.index(self.rig.sensors) for use in uses_of(self.rig, ElementEffect)]
        world_from_sensor = self.world_from_sensor(torch.arange(len(self.sensor)), values)
        if not displaced:
            return gain * self._field_at(values, world_from_sensor)
        has_elements = torch.isin(self.circumstances.sensor, torch.tensor(displaced))
        if has_elements.all():
            return gain * self._at_elements(values, world_from_sensor)
        apart, together = has_elements.nonzero().flatten(), (~has_elements).nonzero().flatten()
        part, rest = self._part(apart), self._part(together)
        one = part._at_elements(values, world_from_sensor.rows(self.place[apart].unique()))
        other = rest._field_at(values, world_from_sensor.rows(self.place[together].unique()))
        batch = torch.broadcast_shapes(one.shape[:-2], other.shape[:-2])
        both = torch.cat((one.expand(*batch, -1, 3), other.expand(*batch, -1, 3)), dim=-2)
        return gain * both[..., torch.argsort(torch.cat((apart, together))), :]

    def _at_elements(self, values: Values, world_from_sensor: Transform) -> Float[Tensor, "*batch reading 3"]:
        """Field in the sensor's frame, each component where its element sits."""
        elements_m: Tensor | None = None
        for use in uses_of(self.rig, ElementEffect):
            offset_m = use.effect.apply(use.theta(values))[..., None, :]  # batch, element, place, axis
            offset_m = offset_m * (self.sensor == use.index(self.rig.sensors))[:, None]
            elements_m = offset_m if elements_m is None else elements_m + offset_m
        assert elements_m is not None
        components = [
            self._field_at(values, _shifted(world_from_sensor, elements_m[..., i, :, :]))[..., i]
            for i in range(3)
        ]
        return torch.stack(torch.broadcast_tensors(*components), dim=-1)

    def _part(self, readings: Int[Tensor, " part"]) -> MeasurementModel:
        """The model of some of the readings."""
        used, place = torch.unique(self.place[readings], return_inverse=True)
        return replace(
            self,
            circumstances=Circumstances(self.rig, self.circumstances.observations.rows(readings)),
            place=place,
            sensor=self.sensor[used],
            flange={name: poses.rows(used) for name, poses in self.flange.items()},
            columns={label: whole[used] for label, whole in self.columns.items()},
            powered={name: torch.isin(used, rows).nonzero().flatten() for name, rows in self.powered.items()},
        )

    def _field_at(self, values: Values, world_from_sensor: Transform) -> Float[Tensor, "*batch reading 3"]:
        """Field in the sensor's frame, at its origin."""
        total = torch.zeros(len(self.circumstances), 3, dtype=self.circumstances.current_A.dtype)
        delivered_A = self.delivered_A(values)
        for use in uses_of(self.rig, RoomEffect):
            theta = use.theta(values)
            steady_T = use.effect.steady_T(world_from_sensor.translation_m, theta)
            if steady_T is not None:
                here = self._everywhere(world_from_sensor.unrotate(steady_T), torch.arange(len(self.sensor)))
                total = total + here[..., self.place, :]
            drifting_T = use.effect.drifting_T(theta, self.circumstances)
            if drifting_T is not None:
                total = total + self._unrotated(world_from_sensor, drifting_T)
        for magnetised in uses_of(self.rig, WindingMagnetisation):
            total = total + self._magnetised(magnetised, values, world_from_sensor, delivered_A)
        for i, coil in enumerate(self.rig.coils):
            rows = self.powered[coil.name]
            if coil.name not in self.rules or not len(rows):
                continue
            for per_unit, drive in self._sources(
                coil, values, world_from_sensor.rows(rows), delivered_A[..., i]
            ):
                field = self._everywhere(per_unit, rows)
                total = total + drive[..., None] * field[..., self.place, :]
        return total

    def _sources(
        self, coil: Coil, values: Values, world_from_sensor: Transform, current_A: Tensor
    ) -> list[tuple[Tensor, Tensor]]:
        """What the coil's current makes where it is powered: field in the sensor frame per unit of drive, and the drive."""
        world_from_coil = self._world_from_body(coil, "coil", self.powered[coil.name], values)
        coil_from_sensor = world_from_coil.inverse() @ world_from_sensor
        points_m = coil_from_sensor.translation_m
        winding = winding_of(self.rig, coil, values)
        field = self._coil_field(coil, points_m, winding)
        found = []
        for use in uses_of(self.rig, SourceEffect, coil.name):
            theta = use.theta(values)
            more = self._sloped(coil, use.effect.apply, points_m, winding, theta)
            drive = use.effect.drive(current_A, theta)
            if drive is current_A:
                field = field + more
            else:
                found.append((coil_from_sensor.unrotate(more), drive))
        field = coil_from_sensor.unrotate(field)
        per_ampere = CoilInRoom(world_from_coil, lambda at_m: self._coil_field(coil, at_m, winding))
        points_m, _ = torch.broadcast_tensors(
            world_from_sensor.translation_m, points_m
        )  # either may stand still
        for answering in uses_of(self.rig, RoomEffect):
            answer = answering.effect.response(per_ampere, points_m, answering.theta(values))
            if answer is not None:
                field = field + world_from_sensor.unrotate(answer)
        return [(field, current_A), *found]

    def _magnetised(
        self,
        use: Use[WindingMagnetisation],
        values: Values,
        world_from_sensor: Transform,
        delivered_A: Float[Tensor, "*#batch reading coil"],
    ) -> Float[Tensor, "*batch reading 3"]:
        """Field of a magnetised winding in the sensor's frame."""
        every = torch.arange(len(self.sensor))
        coil = self.rig.coils[use.index(self.rig.coils)]
        coil_from_sensor = self._world_from_body(coil, "coil", every, values).inverse() @ world_from_sensor
        rings, patterns = use.effect.rings(self.rig, coil)
        drives = use.effect.drives(delivered_A, use.theta(values))
        idle = [i for i, other in enumerate(self.rig.coils) if not len(self.powered[other.name])]
        there = [i for i in range(len(patterns)) if i not in idle]

        def field(points_m: Tensor, _: Sequence[Tensor] = ()) -> Tensor:
            return field_of_rings(points_m, rings, patterns[there]).flatten(-2)

        points_m = coil_from_sensor.translation_m
        flat = with_cheap_slope(field, points_m, ()) if self._is_first_order else field(points_m)
        flat = flat.expand(*flat.shape[:-2], len(every), -1)[..., self.place, :]
        total = (drives[..., there, None] * flat.unflatten(-1, (len(there), 3))).sum(-2)
        return self._unrotated(coil_from_sensor, total)

    def _unrotated(self, poses: Transform, vectors: Float[Tensor, "*#batch reading 3"]) -> Tensor:
        """Vectors of the readings turned into the frames of their sensors; poses are distinct ones, or share one rotation."""
        rotation = poses.rotation if poses.rotation.shape[-3] == 1 else poses.rotation[..., self.place, :, :]
        turned: Tensor = (rotation.mT @ vectors[..., None])[..., 0]
        return turned

    def _coil_field(
        self, coil: Coil, points_coil_m: Float[Tensor, "*#batch point 3"], winding: Winding
    ) -> Float[Tensor, "*batch point 3"]:
        """Field of one ampere in the coil frame, by the coil's rule."""
        return coil_field_per_ampere(coil, points_coil_m, winding, self.rules[coil.name], self.mode)

    @property
    def _is_first_order(self) -> bool:
        """Whether second derivatives may be missing."""
        return self.mode is SumMode.FIRST_ORDER

    def _sloped(
        self, coil: Coil, field: SourceField, points_coil_m: Tensor, winding: Winding, theta: Theta
    ) -> Tensor:
        """What an effect adds to a coil's field, with cheap derivatives where these are asked for."""
        rule = self.rules[coil.name]
        if not self._is_first_order:
            return field(points_coil_m, winding, rule, theta)
        is_fixed = not uses_of(self.rig, WindingEffect, coil.name) and not any(
            self.rig.depends_on_data(f"{coil.name}.{key}") for key in WINDING_KEYS
        )
        geometry = [] if is_fixed else [getattr(winding, one.name) for one in fields(Winding)]

        def of(points_m: Tensor, numbers: Sequence[Tensor]) -> Tensor:
            there = Winding(*numbers[: len(geometry)]) if geometry else winding
            own = dict(zip(theta, numbers[len(geometry) :], strict=True))
            return field(points_m, there, rule, own)

        return with_cheap_slope(of, points_coil_m, [*geometry, *theta.values()])

    def _everywhere(self, field: Tensor, rows: Tensor) -> Tensor:
        """Field at the rows of some poses as one at all poses; of a coil and a sensor that are both fixed, one row stands for all."""
        field = field.expand(*field.shape[:-2], len(rows), 3)
        if len(rows) == len(self.sensor):
            return field
        full = torch.zeros((*field.shape[:-2], len(self.sensor), 3), dtype=field.dtype, device=field.device)
        return full.index_copy(-2, rows, field)

    def _gain(self, values: Values) -> Float[Tensor, "*batch reading"]:
        gains = torch.broadcast_tensors(*(values[f"{s.name}.gain"] for s in self.rig.sensors))
        return torch.stack(gains, dim=-1)[..., self.sensor[self.place]]

    def sensor_in_coil(
        self, coil: Coil, rows: Int[Tensor, " rows"], values: Values
    ) -> tuple[Float[Tensor, "*batch rows 3"], Float[Tensor, "*#batch #rows 3 3"]]:
        """Sensor position in the coil frame and the rotation sensor_from_coil, at distinct poses."""
        coil_from_sensor = self._in_coil(coil, rows, values)
        return coil_from_sensor.translation_m, coil_from_sensor.rotation.mT

    def _in_coil(self, coil: Coil, rows: Int[Tensor, " rows"], values: Values) -> Transform:
        """coil_from_sensor at distinct poses; one row where both stay where they are."""
        world_from_coil = self._world_from_body(coil, "coil", rows, values)
        return world_from_coil.inverse() @ self.world_from_sensor(rows, values)

    def world_from_sensor(self, rows: Int[Tensor, " rows"], values: Values) -> Transform:
        """Pose of the sensor in the room at distinct poses."""
        which = self.sensor[rows]
        poses = [self._world_from_body(s, "sensor", rows, values) for s in self.rig.sensors]
        if len(poses) == 1:
            return poses[0]
        rotation, translation = poses[0].rotation, poses[0].translation_m
        for i, pose in enumerate(poses[1:], start=1):
            mine = which == i
            rotation = torch.where(mine[:, None, None], pose.rotation, rotation)
            translation = torch.where(mine[:, None], pose.translation_m, translation)
        return Transform(rotation, translation)

    def _world_from_body(
        self, body: Body, kind: str, rows: Int[Tensor, " rows"], values: Values
    ) -> Transform:
        flange = {name: poses.rows(rows) for name, poses in self.flange.items()}
        columns = {label: whole[rows] for label, whole in self.columns.items()}
        return world_from_body(self.rig, body, kind, flange, values, columns)

    def _refuse_inside(self, coil: Coil, rows: Tensor, points_m: Tensor, winding: Winding) -> None:
        inside = (distance_to_winding(points_m, winding) <= 0.0).nonzero().flatten()
        if len(inside):
            reading = int(torch.isin(self.place, rows[inside]).nonzero().flatten()[0])
            raise InvalidInput(
                f"sensors must lie outside the winding of {coil.name}; at the rig's nominal values {len(inside)} of "
                f"{len(rows)} places do not, the first at reading {reading} (rig {self.rig.name!r})"
            )


@dataclass(frozen=True)
class CoilInRoom(PerAmpere):
    """One coil as seen from the room, at every distinct pose.

    Attributes:
        world_from_coil: Its pose.
        field_per_ampere: At points of the coil frame.
    """

    world_from_coil: Transform
    field_per_ampere: Callable[[Tensor], Tensor]

    @property
    def position_m(self) -> Float[Tensor, "*#batch #place 3"]:
        """Where the coil is in the world frame."""
        return self.world_from_coil.translation_m

    def at(self, points_m: Float[Tensor, "*#batch place 3"]) -> Float[Tensor, "*batch place 3"]:
        """Field per ampere in the world frame at one point per pose."""
        return self.world_from_coil.rotate(
            self.field_per_ampere(self.world_from_coil.inverse().apply(points_m))
        )

    def at_each(self, points_m: Float[Tensor, "*#batch point 3"]) -> Float[Tensor, "*batch place point 3"]:
        """Field per ampere in the world frame at points that stand still, for every pose."""
        pose = self.world_from_coil
        pose = Transform(pose.rotation[..., None, :, :], pose.translation_m[..., None, :])
        points_coil_m = pose.inverse().apply(points_m[..., None, :, :])
        field = self.field_per_ampere(points_coil_m.flatten(-3, -2))
        return pose.rotate(field.unflatten(-2, points_coil_m.shape[-3:-1]))


def _shifted(pose: Transform, offset_m: Float[Tensor, "*#batch #row 3"]) -> Transform:
    """The same orientation at points off the origin of the body, given in its frame."""
    return Transform(pose.rotation, pose.apply(offset_m))


def _sharing_rotation(poses: Transform) -> Transform:
    """The same poses; where all are turned alike, as under pure translations, the row axis of the rotation is 1.

    Matrix products over rows then happen once: a third of the time of a prediction that is short otherwise.
    """
    first = poses.rotation[:1]
    return Transform(first, poses.translation_m) if bool((poses.rotation == first).all()) else poses
