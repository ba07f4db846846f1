"""Field of a rig's coils anywhere in the room, for one or many parameter sets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from jaxtyping import Bool, Float

from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import MotionEffect, MountEffect
from estimator.effects.use import uses_of
from estimator.errors import InvalidInput, check_known
from estimator.field.machine_code import pays
from estimator.field.winding_shape import DEFAULT_TOLERANCE, Rule, choose_rule
from estimator.field.zones import Zone, zones_of
from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion
from estimator.model.bodies import columns_of
from estimator.model.coil_field import coil_field
from estimator.model.sources import Sources
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Values
from estimator.rig.rig import Rig
from estimator.side_by_side import each
from estimator.tensors import Tensor, torch

NEAR = 0.1  # of a winding's half width
DRAWS_AND_POINTS = 20_000  # at a time: an oval coil holds a dozen arrays of 256 numbers for each


class RoomField:
    """Field of a rig's coils at fixed points of the room, with the movers at one pose or at one for each point.

    Quadrature rules are chosen once, at `values`, by the distance of each point from the winding; the field may then be evaluated for any
    batch of similar parameter sets.

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
        check_known("motion must name movers of the rig", motion, [mover.name for mover in rig.movers])
        for name, rows in motion.items():
            if rows.shape not in ((6,), (1, 6), (len(points_m), 6)):
                raise InvalidInput(
                    f"motion of {name} must be six numbers, or six for each of {len(points_m)} points; "
                    f"received shape {tuple(rows.shape)}"
                )
        self._motion = _motion_of(rig, motion, points_m)
        at_rest = at_one_moment(rig, len(points_m), motion, points_m)
        rules: dict[str, Rule] = {}
        zones: dict[str, tuple[Zone, ...]] = {}
        inside = torch.zeros(len(points_m), dtype=torch.bool, device=points_m.device)
        near = inside.clone()
        for coil in rig.coils:
            world_from_coil = at_rest.world_from_body(coil, "coil", at_rest.powered[coil.name], values)
            points_coil_m = world_from_coil.inverse().apply(points_m)
            field = coil_field(rig, coil, values)
            is_inside = field.has_none(points_coil_m.detach())
            inside |= is_inside
            if field.winding is None or is_inside.all():
                continue
            distance_m = field.winding.distance_m(points_coil_m.detach())
            near |= distance_m < NEAR * field.winding.half_width_m
            if not field.has_zones:
                rules[coil.name] = choose_rule(field.winding, points_coil_m[~is_inside].detach(), tolerance)
                continue
            zones[coil.name] = zones_of(field.winding, distance_m, tolerance)
            rules[coil.name] = zones[coil.name][0].rule
        self.sources = replace(at_rest, rules=rules, zones=zones)
        self.is_inside: Bool[Tensor, " point"] = inside
        self.is_near: Bool[Tensor, " point"] = (
            inside | near
        )  # a winding, so that its field bends over the width of a posterior

    def field_T(
        self,
        values: Values,
        current_A: Float[Tensor, "*#batch coil"],
        points_m: Float[Tensor, "point 3"] | None = None,
    ) -> Float[Tensor, "*batch point 3"]:
        """Flux density in the world frame; NaN at points inside a winding or among other sources (`is_inside` says which)."""
        return self.field_by_point_T(values, current_A[..., None, :], points_m)

    def field_by_point_T(
        self,
        values: Values,
        current_A: Float[Tensor, "*#batch #point coil"],
        points_m: Float[Tensor, "point 3"] | None = None,
    ) -> Float[Tensor, "*batch point 3"]:
        """Flux density in the world frame, in T, with currents of its own at each point; NaN where `is_inside` says so."""
        points_m = self.points_m if points_m is None else points_m
        world_from_point = Transform(
            torch.eye(3, dtype=points_m.dtype, device=points_m.device)[None], points_m
        )
        sources = self._at_currents(current_A)
        delivered_A = sources.delivered_A(current_A, values)
        field_T = sources.field_T(values, delivered_A, world_from_point)
        return torch.where(self.is_inside[:, None], torch.nan, field_T)

    def _at_currents(self, current_A: Float[Tensor, "*#batch #point coil"]) -> Sources:
        """The sources, with coils whose mounts yield to magnetic forces where these currents pull them."""
        moved = [use.label for use in uses_of(self.rig, MountEffect) if use.effect.goes_with_current]
        if not moved:
            return self.sources
        n_moments = max(current_A.shape[-2], *map(len, self._motion.values()), 1)
        by_moment_A = current_A.expand(*current_A.shape[:-2], n_moments, -1)
        columns = columns_of(self.rig, Circumstances(self.rig, _readings(self._motion, by_moment_A)))
        shape = (*by_moment_A.shape[:-1], -1)
        of_moved = {label: columns[label].reshape(shape) for label in moved}
        return replace(self.sources, columns={**self.sources.columns, **of_moved})

    def gradient_T_per_m(
        self, values: Values, current_A: Float[Tensor, "*#batch coil"]
    ) -> Float[Tensor, "*batch point 3 3"]:
        """dB_i / dx_j in the world frame, by forward differentiation: what forces on dipoles need."""
        return self.gradient_by_point_T_per_m(values, current_A[..., None, :])

    def gradient_by_point_T_per_m(
        self, values: Values, current_A: Float[Tensor, "*#batch #point coil"]
    ) -> Float[Tensor, "*batch point 3 3"]:
        """dB_i / dx_j in the world frame, in T/m, with currents of its own at each point; NaN where `is_inside` says so."""
        columns = []
        for axis in range(3):
            direction = torch.zeros_like(self.points_m)
            direction[:, axis] = 1.0
            columns.append(
                torch.func.jvp(
                    lambda p: self.field_by_point_T(values, current_A, p), (self.points_m,), (direction,)
                )[1]
            )
        gradient = torch.stack(columns, dim=-1)
        return torch.where(self.is_inside[:, None, None], torch.nan, gradient)


def some_at_a_time(
    at: Callable[[Values], Float[Tensor, "..."]], draws: Values, n_points: int, n_axes: int
) -> Float[Tensor, "..."]:
    """A function of the values for many draws, some draws at a time on each core: memory stays bounded where effects sum over loops.

    Args:
        at: The function, of values with one batch axis or none; its result is for all points.
        draws: Values along one batch axis; those that are fixed may have none.
        n_points: Number of points.
        n_axes: Axes of the result for one draw.
    Returns: Results with the draws on the first axis; without that axis where nothing depends on the draws.
    """
    n_draws = max((len(value) for value in draws.values() if value.dim()), default=1)
    n_each = max(1, DRAWS_AND_POINTS // max(n_points, 1))

    def some(first: int) -> Tensor:
        return at({k: v[first : first + n_each] if v.dim() else v for k, v in draws.items()})

    said = []
    # Threads would reach the end of what NumPy sums at any draw, and the last digits of a run would be its own.
    for values in (each if pays(0) else map)(some, range(0, n_draws, n_each)):
        if values.dim() == n_axes:
            return values
        said.append(values)
    return torch.cat(said)


def at_one_moment(
    rig: Rig,
    n_points: int = 1,
    motion: Mapping[str, Float[Tensor, "... 6"]] | None = None,
    like: Tensor | None = None,
) -> Sources:
    """Sources at the first moment of a session: nothing has moved, warmed up or drifted yet; quadrature rules are not chosen.

    Args:
        rig: Coils and movers.
        n_points: Points that the field is wanted at.
        motion: Per mover the six numbers of its columns, or a row of them for each point; zeros for a mover that is not named.
        like: A tensor on the device and in the precision that are wanted; double precision on the processor by default.
    """
    zero = torch.zeros(6, dtype=torch.float64) if like is None else like.new_zeros(6)
    rows = _motion_of(rig, motion or {}, zero)
    flange = {m.name: base_from_motion(m, rows[m.name]) for m in rig.movers}
    every_point = torch.arange(n_points, device=zero.device)
    powered = {coil.name: every_point for coil in rig.coils}
    n_moments = max(map(len, rows.values()), default=1) if uses_of(rig, MotionEffect) else 1
    off_A = zero.new_zeros(1, len(rig.coils))
    first = _readings({name: row[:1] for name, row in rows.items()}, off_A)
    # Each moment is a session of its own, so that nothing has moved before any of them.
    places = {name: row[:n_moments].expand(n_moments, 6) for name, row in rows.items()}
    moments = replace(
        _readings(places, off_A.expand(n_moments, -1)), whole=first, chosen=every_point.new_zeros(n_moments)
    )
    columns = columns_of(rig, Circumstances(rig, moments))
    return Sources(rig, Circumstances(rig, first), n_points, None, flange, columns, powered, rules={})


def _motion_of(
    rig: Rig, motion: Mapping[str, Float[Tensor, "... 6"]], like: Tensor
) -> dict[str, Float[Tensor, "row 6"]]:
    """Rows of every mover; zeros for one that is not named."""
    return {m.name: motion.get(m.name, like.new_zeros(6)).reshape(-1, 6) for m in rig.movers}


def _readings(
    motion: Mapping[str, Float[Tensor, "#moment 6"]], current_A: Float[Tensor, "*batch moment coil"]
) -> Observations:
    """A session whose readings have these currents, one after another, with every mover at its row of the moment."""
    n_moments = current_A.shape[-2]
    flat_A = current_A.reshape(-1, current_A.shape[-1])
    n = len(flat_A)
    zeros, index = flat_A.new_zeros(n), torch.zeros(n, dtype=torch.int64, device=flat_A.device)
    places = {name: rows.expand(n_moments, 6).repeat(n // n_moments, 1) for name, rows in motion.items()}
    return Observations(zeros, index, flat_A, places, flat_A.new_zeros(n, 3), index.bool(), index, {})
