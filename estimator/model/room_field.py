"""Field of a rig's coils anywhere in the room, for one or many parameter sets."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.func import jvp

from estimator.effects.base import CurrentEffect, RoomEffect, SourceEffect, WindingMagnetisation
from estimator.effects.circumstances import Circumstances
from estimator.effects.record import UnitError
from estimator.effects.supply import CoilHeating
from estimator.effects.use import uses_of
from estimator.errors import InvalidInput
from estimator.field.coil import coil_field_per_ampere
from estimator.field.magnetised import field_of_rings
from estimator.field.winding import (
    DEFAULT_TOLERANCE,
    Rule,
    choose_rule,
    distance_to_winding,
)
from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion
from estimator.model.bodies import static_columns, winding_of, world_from_body
from estimator.model.measurement_model import CoilInRoom
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Values
from estimator.rig.rig import Coil, Rig


class RoomField:
    """The coils of a rig with its movers at one stand, or at one for each point, ready to give the field at fixed points of the room.

    Quadrature rules are chosen once, at `values`; the field may then be evaluated for any batch of similar parameter sets.

    Args:
        rig: Coils and movers.
        values: Numbers of the rig, no batch.
        points_m: Points in the room (world frame).
        motion: Per mover the six numbers of its columns, or a row of them for each point; a mover that is not named stands at zeros (its
            reference configuration). The field may be differentiated in them.
        tolerance: Error of the winding sum relative to |B|.
    Raises:
        InvalidInput: A motion names no mover of the rig, or has neither one row nor one for each point.
    """

    def __init__(
        self,
        rig: Rig,
        values: Values,
        points_m: Float[Tensor, "point 3"],
        motion: Mapping[str, Float[Tensor, "... 6"]] | None = None,
        tolerance: float = DEFAULT_TOLERANCE,
    ) -> None:
        self.rig, self.points_m = rig, points_m
        motion = motion or {}
        names = [mover.name for mover in rig.movers]
        unknown = [name for name in motion if name not in names]
        if unknown:
            raise InvalidInput(
                f"motion must name movers of the rig ({', '.join(names) or 'none'}); received {unknown[0]!r}"
            )
        for name, rows in motion.items():
            if rows.shape not in ((6,), (1, 6), (len(points_m), 6)):
                raise InvalidInput(
                    f"motion of {name} must be six numbers, or six for each of {len(points_m)} points; "
                    f"received shape {tuple(rows.shape)}"
                )
        zero = torch.zeros(6, dtype=points_m.dtype)
        self.flange = {
            m.name: base_from_motion(m, motion.get(m.name, zero).reshape(-1, 6)) for m in rig.movers
        }
        self._scene = Circumstances(rig, _one_reading(rig))
        self.rules: dict[str, Rule] = {}
        inside = torch.zeros(len(points_m), dtype=torch.bool)
        for coil in rig.coils:
            points_coil_m = self._world_from_coil(coil, values).inverse().apply(points_m)
            winding = winding_of(rig, coil, values)
            within = distance_to_winding(points_coil_m, winding) <= 0.0
            inside |= within
            if not within.all():
                self.rules[coil.name] = choose_rule(winding, points_coil_m[~within], tolerance)
        self.is_inside: Bool[Tensor, " point"] = inside

    def field_T(
        self,
        values: Values,
        current_A: Float[Tensor, "*#batch coil"],
        points_m: Float[Tensor, "point 3"] | None = None,
    ) -> Float[Tensor, "*batch point 3"]:
        """Flux density in the world frame; NaN at points that lie inside a winding (`is_inside` says which)."""
        points_m = self.points_m if points_m is None else points_m
        total = torch.zeros_like(points_m)
        delivered_A = self._delivered_A(values, current_A)
        for i, coil in enumerate(self.rig.coils):
            if coil.name not in self.rules:
                continue
            winding, rule = winding_of(self.rig, coil, values), self.rules[coil.name]
            world_from_coil = self._world_from_coil(coil, values)
            points_coil_m = world_from_coil.inverse().apply(points_m)
            per_ampere = partial(coil_field_per_ampere, coil, winding=winding, rule=rule)
            own_A = delivered_A[..., i]
            field = own_A[..., None, None] * per_ampere(points_coil_m)
            for use in uses_of(self.rig, SourceEffect, coil.name):
                theta = use.theta(values)
                drive = use.effect.drive(own_A[..., None], theta)[..., None]
                field = field + drive * use.effect.apply(points_coil_m, winding, rule, theta)
            field = world_from_coil.rotate(field)
            for answering in uses_of(self.rig, RoomEffect):
                theta = answering.theta(values)
                answer = answering.effect.response(CoilInRoom(world_from_coil, per_ampere), points_m, theta)
                if answer is not None:
                    field = field + own_A[..., None, None] * answer
            total = total + field
        for magnetised in uses_of(self.rig, WindingMagnetisation):
            coil = self.rig.coils[magnetised.index(self.rig.coils)]
            world_from_coil = self._world_from_coil(coil, values)
            rings, patterns = magnetised.effect.rings(self.rig, coil)
            each = field_of_rings(world_from_coil.inverse().apply(points_m), rings, patterns)
            drives = magnetised.effect.drives(delivered_A[..., None, :], magnetised.theta(values))
            total = total + world_from_coil.rotate((drives[..., None] * each).sum(-2))
        for room in uses_of(self.rig, RoomEffect):
            steady_T = room.effect.steady_T(points_m, room.theta(values))
            if steady_T is not None:
                total = total + steady_T
        return torch.where(self.is_inside[:, None], torch.nan, total)

    def gradient_T_per_m(
        self, values: Values, current_A: Float[Tensor, "*#batch coil"]
    ) -> Float[Tensor, "*batch point 3 3"]:
        """dB_i / dx_j in the world frame, by forward differentiation: what forces on dipoles need."""
        columns = []
        for axis in range(3):
            direction = torch.zeros_like(self.points_m)
            direction[:, axis] = 1.0
            columns.append(
                jvp(lambda p: self.field_T(values, current_A, p), (self.points_m,), (direction,))[1]
            )
        gradient = torch.stack(columns, dim=-1)
        return torch.where(self.is_inside[:, None, None], torch.nan, gradient)

    def _delivered_A(self, values: Values, current_A: Tensor) -> Float[Tensor, "*batch coil"]:
        """Currents that flow when these are commanded to cold coils; what heats needs a history."""
        gains = torch.broadcast_tensors(*(values[f"{coil.name}.current_gain"] for coil in self.rig.coils))
        delivered_A = (torch.stack(gains, dim=-1) * current_A)[..., None, :]
        for record in uses_of(self.rig, UnitError):
            delivered_A = record.effect.current_A(delivered_A, record.theta(values))
        for use in uses_of(self.rig, CurrentEffect):
            if not isinstance(use.effect, CoilHeating):
                i = use.index(self.rig.coils)
                delivered_A = use.effect.apply(delivered_A, use.theta(values), self._scene, i)
        return delivered_A[..., 0, :]

    def _world_from_coil(self, coil: Coil, values: Values) -> Transform:
        return world_from_body(self.rig, coil, "coil", self.flange, values, static_columns(self.rig))


def _one_reading(rig: Rig) -> Observations:
    """A session of one moment without currents: what effects without memory need to know of one."""
    zeros = torch.zeros(1, dtype=torch.float64)
    motion = {mover.name: zeros.expand(6)[None] for mover in rig.movers}
    index, flag = torch.zeros(1, dtype=torch.int64), torch.zeros(1, dtype=torch.bool)
    return Observations(
        zeros, index, zeros.expand(len(rig.coils))[None], motion, zeros.expand(3)[None], flag, index, {}
    )
