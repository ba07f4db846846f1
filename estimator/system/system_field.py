"""A system at fixed points: field, gradient, force, their intervals, and currents for a wanted field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from jaxtyping import Float

from estimator.calibration.result import check_level
from estimator.effects.base import Effect
from estimator.effects.use import uses_of
from estimator.errors import InvalidInput
from estimator.model.room_field import RoomField
from estimator.rig.coordinates import Values
from estimator.system.actuation import (
    bounded_currents,
    force_matrix,
    independent_entries,
    minimum_norm_currents,
)
from estimator.tensors import Tensor, torch

if TYPE_CHECKING:
    from estimator.system.system import System


@dataclass(frozen=True)
class SystemField:
    """A system at fixed points with its movers at rest, made by `System.at`. Results are NaN at points inside a winding.

    Attributes:
        system: The calibrated coils.
        rooms: Its parts with their movers in the given poses.
    """

    system: System
    rooms: tuple[RoomField, ...]

    def field_T(self, current_A: Float[Tensor, "*batch coil"]) -> Float[Tensor, "*batch point 3"]:
        """Flux density in the world frame: the sum over all coils (paper, eq 14-16)."""
        return self._sum(RoomField.field_T, self._best, current_A)

    def gradient_T_per_m(self, current_A: Float[Tensor, "*batch coil"]) -> Float[Tensor, "*batch point 3 3"]:
        """dB_i / dx_j in the world frame; symmetric and traceless."""
        return self._sum(RoomField.gradient_T_per_m, self._best, current_A)

    def field_interval_T(
        self, current_A: Float[Tensor, "*batch coil"], level: float = 0.9
    ) -> tuple[Float[Tensor, "*batch point 3"], Float[Tensor, "*batch point 3"]]:
        """Lower and upper end of the credible interval of each component, with independent errors of the calibrations.

        Raises:
            InvalidInput: Level outside (0, 1).
        """
        return self._interval(RoomField.field_T, current_A, level, 2)

    def gradient_interval_T_per_m(
        self, current_A: Float[Tensor, "*batch coil"], level: float = 0.9
    ) -> tuple[Float[Tensor, "*batch point 3 3"], Float[Tensor, "*batch point 3 3"]]:
        """Lower and upper end of the credible interval of each entry of the gradient, as `field_interval_T`."""
        return self._interval(RoomField.gradient_T_per_m, current_A, level, 3)

    def force_N(
        self, moment_A_m2: Float[Tensor, "*#batch 3"], current_A: Float[Tensor, "*currents coil"]
    ) -> Float[Tensor, "*currents point 3"]:
        """Force on a dipole of constant moment: the gradient of m.B (Jackson, 3rd ed., eq 5.69).

        Args:
            moment_A_m2: Moment in the world frame, one for all points or one each.
            current_A: Currents of the coils.
        """
        return (moment_A_m2[..., None, :] @ self.gradient_T_per_m(current_A))[..., 0, :]

    def actuation(self, has_gradient: bool = True) -> Float[Tensor, "point row coil"]:
        """Field and gradient per ampere of each coil: rows Bx, By, Bz, then dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz.

        Args:
            has_gradient: False leaves out the last five rows, at a third of the cost.
        Raises:
            InvalidInput: A core saturates, so the field is not proportional to the current.
        """
        for part in self.system.parts:
            for use in (use for use in uses_of(part.rig, Effect) if not use.effect.is_linear):
                raise InvalidInput(
                    f"actuation needs a field proportional to the currents; with {use.label} that of {use.place} is not"
                )
        n = len(self.system.coils)
        steps_A = torch.cat((torch.zeros(1, n), torch.eye(n))).to(torch.float64)
        field_T = self.field_T(steps_A)
        columns = field_T[1:] - field_T[:1]
        if has_gradient:
            gradient = self.gradient_T_per_m(steps_A)
            columns = torch.cat((columns, independent_entries(gradient[1:] - gradient[:1])), dim=-1)
        return columns.movedim(0, -1)

    def currents_for_field(
        self, field_T: Float[Tensor, "*batch point 3"], most_A: Float[Tensor, " coil"] | float | None = None
    ) -> Float[Tensor, "*batch point coil"]:
        """Currents that make a field; each row is for its point alone.

        Args:
            field_T: Wanted total field, with what is there without current.
            most_A: Largest magnitude of all currents or of each; the result then has no derivatives. None gives currents of minimum norm.
        Returns: Currents that come closest, in ampere; `actuation` tells the field they make.
        """
        wanted_T = field_T - self.field_T(self._off())
        return self._currents(self.actuation(has_gradient=False), wanted_T, most_A)

    def currents_for_force(
        self,
        moment_A_m2: Float[Tensor, "*#batch 3"],
        force_N: Float[Tensor, "*batch point 3"],
        most_A: Float[Tensor, " coil"] | float | None = None,
    ) -> Float[Tensor, "*batch point coil"]:
        """Currents that exert a force on a dipole of constant moment, point by point; arguments as in `currents_for_field`."""
        wanted_N = force_N - self.force_N(moment_A_m2, self._off())
        return self._currents(force_matrix(self.actuation(), moment_A_m2), wanted_N, most_A)

    @cached_property
    def _best(self) -> tuple[Values, ...]:
        return tuple(part.best_values() for part in self.system.parts)

    def _off(self) -> Float[Tensor, " coil"]:
        return torch.zeros(len(self.system.coils), dtype=torch.float64)

    def _sum(
        self,
        quantity: Callable[[RoomField, Values, Tensor], Tensor],
        values: tuple[Values, ...],
        current_A: Tensor,
    ) -> Tensor:
        """Sum of a quantity of the field over the parts."""
        total = torch.zeros((), dtype=torch.float64)
        for room, part_values in zip(self.rooms, values, strict=True):
            columns = [self.system.coils.index(coil.name) for coil in room.rig.coils]
            total = total + quantity(room, part_values, current_A[..., columns])
        return total

    def _interval(
        self,
        quantity: Callable[[RoomField, Values, Tensor], Tensor],
        current_A: Tensor,
        level: float,
        n_axes: int,
    ) -> tuple[Tensor, Tensor]:
        check_level(level)
        draws = self.system.draws()
        sampled = self._sum(quantity, draws, current_A[..., None, :])
        tails = torch.tensor([0.5 - 0.5 * level, 0.5 + 0.5 * level], dtype=sampled.dtype)
        batch, rest = current_A.shape[:-1], sampled.shape[-n_axes:]
        n = max((value.shape[0] for values in draws for value in values.values() if value.ndim), default=1)
        lower, upper = torch.quantile(sampled.expand(*batch, n, *rest), tails, dim=-n_axes - 1)
        return lower, upper

    def _currents(
        self, matrix: Tensor, target: Tensor, most_A: Float[Tensor, " coil"] | float | None
    ) -> Tensor:
        if most_A is None:
            return minimum_norm_currents(matrix, target)
        bound_A = torch.as_tensor(most_A, dtype=torch.float64).expand(len(self.system.coils))
        return bounded_currents(matrix, target, bound_A)
