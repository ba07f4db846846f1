"""Everything that makes a field: from recorded currents and poses to the field at sensors, or at points of the room.

The measurement model asks for the field at the sensors of a session, `RoomField` for the field at points that nobody measured: both get
it here, so that what a session is fitted with is what a prediction is made with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import cast

from jaxtyping import Float, Int

from estimator.effects import stages
from estimator.effects.base import Kind, Theta
from estimator.effects.circumstances import Circumstances
from estimator.effects.use import Use, uses_of
from estimator.field.core import PATTERNS
from estimator.field.first_order import first_order_field
from estimator.field.grid_map import GridMap
from estimator.field.loop import NEAREST_STEPS
from estimator.field.magnetised import field_of_rings, field_of_rings_to_first_order
from estimator.field.node_sum import SumMode
from estimator.field.winding import Winding
from estimator.field.winding_shape import Rule
from estimator.field.zones import Zone
from estimator.frames import Transform, turned, turned_back
from estimator.model.bodies import WINDING_KEYS, world_from_body
from estimator.model.coil_field import CoilField, coil_field
from estimator.model.coil_in_room import CoilInRoom
from estimator.model.cores import Cores
from estimator.rig.bodies import AnyCoil, Body
from estimator.rig.coordinates import Values
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

# Of points in a coil's frame, as `SourceEffect.apply`.
SourceField = Callable[[Tensor, Winding, Rule, Theta], Tensor]


@dataclass(frozen=True)
class Sources:
    """Coils, room and magnetised windings of a rig, with its movers at the poses of some readings.

    Readings that share a pose share its geometry: +I, -I and repeats at one pose cost one field evaluation. A table holds the distinct
    poses; `pose_row` says which of its rows each reading has.

    Attributes:
        rig: What is modelled.
        circumstances: Of the readings, or of one moment that stands for all.
        n_rows: Distinct poses.
        pose_row: Row of each reading; None where every reading has the row of its own number.
        flange: Per mover base_from_flange (or the displacement) by row; one row, or one rotation, may stand for all.
        columns: Per effect that moves bodies, what else it depends on, by row; one row may stand for all.
        powered: Per coil the rows where it ever carries current, or has a field without.
        rules: Per winding the quadrature rule; windings without one are left out.
        mode: How loops are summed: to first order for fits.
        zones: Per winding a rule for each row, where one for all would be wasteful; only for a coil that is powered in every row.
        maps: Per coil a field map that stands for its winding.
    """

    rig: Rig
    circumstances: Circumstances
    n_rows: int
    pose_row: Int[Tensor, " reading"] | None
    flange: Mapping[str, Transform]
    columns: Mapping[str, Tensor]
    powered: Mapping[str, Int[Tensor, " powered"]]
    rules: Mapping[str, Rule]
    mode: SumMode = SumMode.PLAIN
    zones: Mapping[str, Sequence[Zone]] = field(default_factory=dict)
    maps: Mapping[str, GridMap] = field(default_factory=dict)

    def part(self, readings: Int[Tensor, " part"]) -> Sources:
        """The sources as some of the readings see them."""
        rows = readings if self.pose_row is None else self.pose_row[readings]
        used, pose_row = torch.unique(rows, return_inverse=True)
        return replace(
            self,
            circumstances=Circumstances(self.rig, self.circumstances.observations.rows(readings)),
            n_rows=len(used),
            pose_row=pose_row,
            flange={name: poses.rows(used) for name, poses in self.flange.items()},
            columns={label: whole[used] for label, whole in self.columns.items()},
            powered={name: torch.isin(used, rows).nonzero().flatten() for name, rows in self.powered.items()},
        )

    def delivered_A(
        self, recorded_A: Float[Tensor, "*#batch #reading coil"], values: Values
    ) -> Float[Tensor, "*batch #reading coil"]:
        """Currents that really flow, given those that were recorded."""
        gains = torch.broadcast_tensors(*(values[f"{coil.name}.current_gain"] for coil in self.rig.coils))
        current_A = torch.stack(gains, dim=-1)[..., None, :] * recorded_A
        for record in uses_of(self.rig, stages.RecordEffect):
            current_A = record.effect.commanded_A(current_A, record.theta(values))
        for use in uses_of(self.rig, stages.CurrentEffect):
            theta, coil = use.theta(values), use.index(self.rig.coils)
            current_A = use.effect.apply(current_A, theta, self.circumstances, coil)
        return current_A

    def field_T(
        self, values: Values, delivered_A: Float[Tensor, "*#batch #reading coil"], world_from_point: Transform
    ) -> Float[Tensor, "*batch reading 3"]:
        """Field at the points of some rows, in the frames of these points.

        Args:
            values: Every number of the rig by name.
            delivered_A: Currents that flow.
            world_from_point: Where the points stand and how they are turned, by row.
        """
        n_readings = self.n_rows if self.pose_row is None else len(self.pose_row)
        total = delivered_A.new_zeros(n_readings, 3)
        for room in uses_of(self.rig, stages.RoomEffect):
            theta = room.theta(values)
            steady_T = room.effect.steady_T(world_from_point.translation_m, theta)
            if steady_T is not None:
                total = total + self._by_reading(world_from_point.unrotate(steady_T), self._every_row)
            drifting_T = room.effect.drifting_T(theta, self.circumstances)
            if drifting_T is not None:
                total = total + self._unrotated(world_from_point, drifting_T)
        for magnetised in uses_of(self.rig, stages.WindingMagnetisation):
            total = total + self._magnetised(magnetised, values, world_from_point, delivered_A)
        if uses_of(self.rig, stages.CoreMagnetisation):
            total = total + self._cores(values, world_from_point, delivered_A)
        for i, coil in enumerate(self.rig.coils):
            rows = self.powered[coil.name]
            is_ready = not coil.is_wound or coil.name in self.rules
            if not is_ready or not len(rows):
                continue
            points = world_from_point.rows(rows)
            for per_unit, drive in self._driven(coil, values, points, delivered_A[..., i]):
                total = total + drive[..., None] * self._by_reading(per_unit, rows)
        return total

    def world_from_body(self, body: Body, kind: str, rows: Int[Tensor, " rows"], values: Values) -> Transform:
        """Pose of a coil or a sensor at some rows; one row where it stays where it is."""
        flange = {name: poses.rows(rows) for name, poses in self.flange.items()}
        columns = {
            label: whole if whole.shape[-2] == 1 else whole[..., rows, :]
            for label, whole in self.columns.items()
        }
        return world_from_body(self.rig, body, kind, flange, values, columns)

    def _driven(
        self, coil: AnyCoil, values: Values, world_from_point: Transform, current_A: Tensor
    ) -> list[tuple[Tensor, Tensor]]:
        """Field of a powered coil in the points' frames per unit of drive, and the drive."""
        world_from_coil = self.world_from_body(coil, "coil", self.powered[coil.name], values)
        points_m = world_from_coil.locate(world_from_point.translation_m)

        def to_points(field: Tensor) -> Tensor:
            """Field in the axes of the points, from that in the axes of the coil.

            It goes by the room, whose steps are cheaper than the product of both rotations, unless that is the same for all rows.
            """
            if world_from_point.rotation.shape[-3] == world_from_coil.rotation.shape[-3] == 1:
                return turned(world_from_point.rotation.mT @ world_from_coil.rotation, field)
            return world_from_point.unrotate(world_from_coil.rotate(field))

        about = coil_field(self.rig, coil, values)
        own = about.by(self.rules.get(coil.name), self.mode)
        if coil.name in self.maps:
            own = self.maps[coil.name].field
        field = self._zoned(about, points_m, coil.name) if coil.name in self.zones else own(points_m)
        driven = []
        for use in uses_of(self.rig, stages.SourceEffect, coil.name):
            theta, winding = use.theta(values), cast(Winding, about.winding)  # of any shape for a correction
            if isinstance(use.effect, stages.AddedLoops):
                more = use.effect.apply(points_m, winding, self.rules[coil.name], theta, self.mode)
            elif use.effect.is_correction:  # polynomials, whose second derivatives cost little
                more = use.effect.apply(points_m, winding, self.rules[coil.name], theta)
            else:
                more = self._sloped(coil.name, use.effect.apply, points_m, winding, theta)
            drive = use.effect.drive(current_A, theta)
            if drive is current_A:
                field = field + more
            else:
                driven.append((to_points(more), drive))
        field = to_points(field)
        per_ampere = CoilInRoom(world_from_coil, own)
        # Either may stand still.
        points_m, _ = torch.broadcast_tensors(world_from_point.translation_m, points_m)
        for answering in uses_of(self.rig, stages.RoomEffect):
            if answering.effect.kind is Kind.COIL and answering.place != coil.name:
                continue
            answer = answering.effect.response(per_ampere, points_m, answering.theta(values))
            if answer is not None:
                field = field + world_from_point.unrotate(answer)
        return [(field, current_A), *driven]

    def _magnetised(
        self,
        use: Use[stages.WindingMagnetisation],
        values: Values,
        world_from_point: Transform,
        delivered_A: Float[Tensor, "*#batch #reading coil"],
    ) -> Float[Tensor, "*batch reading 3"]:
        """Field of a magnetised winding in the frames of the points."""
        coil = self.rig.round[use.index(self.rig.round)]
        world_from_coil = self.world_from_body(coil, "coil", self._every_row, values)
        points_m = world_from_coil.locate(world_from_point.translation_m)
        rings, patterns = use.effect.rings(self.rig, coil)
        rings, patterns = rings.to(delivered_A.device), patterns.to(delivered_A.device)
        drives = use.effect.drives(delivered_A, use.theta(values))
        idle = [i for i, source in enumerate(self.rig.coils) if not len(self.powered[source.name])]
        there = [i for i in range(len(patterns)) if i not in idle]
        field = field_of_rings_to_first_order if self._is_first_order else field_of_rings
        steps = self.rules[coil.name].steps if coil.name in self.rules else NEAREST_STEPS
        flat = self._by_reading(field(points_m, rings, patterns[there], steps).flatten(-2), self._every_row)
        total = (drives[..., there, None] * flat.unflatten(-1, (len(there), 3))).sum(-2)
        return self._unrotated(world_from_point, self._rotated(world_from_coil, total))

    def _cores(
        self, values: Values, world_from_point: Transform, delivered_A: Float[Tensor, "*#batch #reading coil"]
    ) -> Float[Tensor, "*batch reading 3"]:
        """Field of all iron cores in the frames of the points."""
        poses = {
            coil.name: self.world_from_body(coil, "coil", self._every_row, values) for coil in self.rig.wound
        }
        cores = Cores.of(self.rig, values, poses, self.circumstances, self._is_first_order)
        total = delivered_A.new_zeros(1)
        for core, polarisation_T in zip(
            cores.members, cores.polarisations_T(delivered_A, self.pose_row), strict=True
        ):
            points_m = core.world_from_coil.locate(world_from_point.translation_m)
            per_T = core.field_at(points_m, self._is_first_order)
            flat = self._by_reading(per_T.flatten(-2), self._every_row)
            field_T = (polarisation_T[..., None, :] @ flat.unflatten(-1, (PATTERNS, 3)))[..., 0, :]
            total = total + self._unrotated(world_from_point, self._rotated(core.world_from_coil, field_T))
        return total

    @cached_property
    def _every_row(self) -> Int[Tensor, " row"]:
        return torch.arange(self.n_rows, device=self.circumstances.observations.device)

    def _by_reading(self, field: Tensor, rows: Int[Tensor, " rows"]) -> Tensor:
        """Field at all readings from that at some rows, zero elsewhere. One row stands for all where coil and point both stand still."""
        field = field.expand(*field.shape[:-2], len(rows), -1)
        if len(rows) < self.n_rows:
            nothing = field.new_zeros(*field.shape[:-2], self.n_rows, field.shape[-1])
            field = nothing.index_copy(-2, rows, field)
        return field if self.pose_row is None else field[..., self.pose_row, :]

    def _rotated(self, poses: Transform, vectors: Float[Tensor, "*#batch #reading 3"]) -> Tensor:
        """Vectors of the readings turned from the frames of their poses into the room."""
        return turned(self._rotation_by_reading(poses), vectors)

    def _unrotated(self, poses: Transform, vectors: Float[Tensor, "*#batch #reading 3"]) -> Tensor:
        """Vectors of the readings in the room turned into the frames of their poses."""
        return turned_back(self._rotation_by_reading(poses), vectors)

    def _rotation_by_reading(self, poses: Transform) -> Float[Tensor, "*#batch #reading 3 3"]:
        """Rotations of poses, which are by row or share one."""
        is_shared = poses.rotation.shape[-3] == 1 or self.pose_row is None
        return poses.rotation if is_shared else poses.rotation[..., self.pose_row, :, :]

    def _zoned(
        self, about: CoilField, points_coil_m: Float[Tensor, "*#batch row 3"], coil: str
    ) -> Float[Tensor, "*batch row 3"]:
        """Field of one ampere in a coil's winding in the coil frame, by the rule of each point."""
        zones = self.zones[coil]
        parts = [about.by(zone.rule, self.mode)(points_coil_m[..., zone.points, :]) for zone in zones]
        order = torch.cat([zone.points for zone in zones]).argsort()
        return torch.cat(parts, dim=-2)[..., order, :]

    @property
    def _is_first_order(self) -> bool:
        """Whether second derivatives may be missing."""
        return self.mode is SumMode.FIRST_ORDER

    def _sloped(
        self, coil: str, field: SourceField, points_coil_m: Tensor, winding: Winding, theta: Theta
    ) -> Tensor:
        """Addition of an effect to a coil's field, with cheap derivatives where second ones may be missing."""
        rule = self.rules[coil]
        if not self._is_first_order:
            return field(points_coil_m, winding, rule, theta)
        is_fixed = not uses_of(self.rig, stages.WindingEffect, coil) and not any(
            self.rig.depends_on_data(f"{coil}.{key}") for key in WINDING_KEYS
        )
        geometry = [] if is_fixed else [getattr(winding, item.name) for item in fields(Winding)]

        def of(points_m: Tensor, numbers: Sequence[Tensor]) -> Tensor:
            there = Winding(*numbers[: len(geometry)]) if geometry else winding
            quantities = dict(zip(theta, numbers[len(geometry) :], strict=True))
            return field(points_m, there, rule, quantities)

        return first_order_field(of, points_coil_m, [*geometry, *theta.values()])
