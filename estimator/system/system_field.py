"""A system at fixed points: field, gradient, force, their intervals, and currents for a wanted field.

Arguments may be tensors, arrays, lists or labelled arrays; answers are of the kind of the points.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from jaxtyping import Float

from estimator.calibration.result import check_level
from estimator.effects.base import Effect
from estimator.effects.use import uses_of
from estimator.errors import InvalidInput
from estimator.model.room_field import RoomField
from estimator.points import AXES, FIELD, GRADIENT, Answer, Points, given_numbers, given_points
from estimator.rig.coordinates import Values
from estimator.system.actuation import (
    INDEPENDENT,
    bounded_currents,
    force_matrix,
    independent_entries,
    minimum_norm_currents,
)
from estimator.system.parts import CalibratedCoils
from estimator.tensors import Tensor, torch

FORCE = Answer("force", "N", {"component": AXES})
FIELD_ROWS = tuple(f"B{axis}" for axis in AXES)
GRADIENT_ROWS = tuple(f"dB{AXES[i]}/d{AXES[j]}" for i, j in INDEPENDENT)


@dataclass(frozen=True)
class SystemField:
    """A system at fixed points with its movers at rest, made by `System.at`. Results are NaN at points inside a winding.

    Currents are given by coil, as `{"coil1": 2.0}`, or as numbers in the order of `System.coils`, also for a batch. Answers are of the kind
    of the points, in which their axes stand behind those of the batch.

    Attributes:
        system: The calibrated coils.
        rooms: Its parts with their movers in the given poses.
        points: Where.
    """

    system: CalibratedCoils
    rooms: tuple[RoomField, ...]
    points: Points

    def field_T(self, current_A: Any) -> Any:
        """Flux density in the world frame: the sum over all coils (paper, eq 14-16)."""
        field_T = self._sum(RoomField.field_T, self._best, self._currents_A(current_A))
        return self.points.answer(field_T, FIELD)

    def gradient_T_per_m(self, current_A: Any) -> Any:
        """dB_i / dx_j in the world frame; symmetric and traceless."""
        return self.points.answer(self._gradient_T_per_m(self._currents_A(current_A)), GRADIENT)

    def field_interval_T(self, current_A: Any, level: float = 0.9) -> tuple[Any, Any]:
        """Lower and upper end of the credible interval of each component, with independent errors of the calibrations.

        Raises:
            InvalidInput: Level outside (0, 1).
        """
        return self._interval(RoomField.field_T, current_A, level, FIELD)

    def gradient_interval_T_per_m(self, current_A: Any, level: float = 0.9) -> tuple[Any, Any]:
        """Lower and upper end of the credible interval of each entry of the gradient, as `field_interval_T`."""
        return self._interval(RoomField.gradient_T_per_m, current_A, level, GRADIENT)

    def force_N(self, moment_A_m2: Any, current_A: Any) -> Any:
        """Force on a dipole of constant moment: the gradient of m.B (Jackson, 3rd ed., eq 5.69).

        Args:
            moment_A_m2: Moment in the world frame, one for all points or one each.
            current_A: Currents of the coils.
        """
        moment = self._vectors(moment_A_m2, "moments")
        return self.points.answer(self._force_N(moment, self._currents_A(current_A)), FORCE)

    def actuation(self, has_gradient: bool = True) -> Any:
        """Field and gradient per ampere of each coil: rows Bx, By, Bz, then dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz; a column a coil.

        Args:
            has_gradient: False leaves out the last five rows, at a third of the cost.
        Raises:
            InvalidInput: A core saturates, so the field is not proportional to the current.
        """
        rows = (*FIELD_ROWS, *GRADIENT_ROWS) if has_gradient else FIELD_ROWS
        axes = {"row": rows, "coil": self.system.coils}
        unit = "T/A, T/(A m)" if has_gradient else "T/A"
        return self.points.answer(self._actuation(has_gradient), Answer("field per ampere", unit, axes))

    def currents_for_field(self, field_T: Any, most_A: Any = None) -> Any:
        """Currents that make a field; each row is for its point alone.

        Args:
            field_T: Wanted total field at each point, with what is there without current.
            most_A: Largest magnitude of all currents or of each; the result then has no derivatives. None gives currents of minimum norm.
        Returns: Currents that come closest, in ampere, of each coil at each point; `actuation` tells the field they make.
        """
        without_T = self._sum(RoomField.field_T, self._best, self._off())
        wanted_T = self._vectors(field_T, "fields") - without_T
        return self._currents(self._actuation(has_gradient=False), wanted_T, most_A)

    def currents_for_force(self, moment_A_m2: Any, force_N: Any, most_A: Any = None) -> Any:
        """Currents that exert a force on a dipole of constant moment, point by point; arguments as in `currents_for_field`."""
        moment = self._vectors(moment_A_m2, "moments")
        wanted_N = self._vectors(force_N, "forces") - self._force_N(moment, self._off())
        return self._currents(force_matrix(self._actuation(), moment), wanted_N, most_A)

    @cached_property
    def _best(self) -> tuple[Values, ...]:
        return tuple(part.best_values() for part in self.system.parts)

    def _off(self) -> Float[Tensor, " coil"]:
        return torch.zeros(len(self.system.coils), dtype=torch.float64)

    def _currents_A(self, current_A: Any) -> Float[Tensor, "*batch coil"]:
        """Currents in the order of the coils."""
        if isinstance(current_A, Mapping):
            return self.system.currents(current_A)
        names = ", ".join(self.system.coils)
        rule = f"currents must be a number for each coil ({names}), or given by coil"
        numbers_A = given_numbers(current_A, rule).double()
        if numbers_A.shape[-1:] != (len(self.system.coils),):
            raise InvalidInput(f"{rule}; received shape {tuple(numbers_A.shape)}")
        return numbers_A

    def _vectors(self, vectors: Any, what: str) -> Float[Tensor, "*batch 3"]:
        """Vectors for each point, in rows; those for all points stay as they are."""
        given = given_points(vectors, what)
        n_before = len(given.shape) - len(self.points.shape)
        is_each = given.shape[n_before:] == self.points.shape
        shape = (*given.shape[:n_before], -1) if is_each else given.shape
        return given.points_m.reshape(*shape, 3)

    def _gradient_T_per_m(self, current_A: Tensor) -> Float[Tensor, "*batch point 3 3"]:
        return self._sum(RoomField.gradient_T_per_m, self._best, current_A)

    def _force_N(self, moment_A_m2: Tensor, current_A: Tensor) -> Float[Tensor, "*batch point 3"]:
        return (moment_A_m2[..., None, :] @ self._gradient_T_per_m(current_A))[..., 0, :]

    def _actuation(self, has_gradient: bool = True) -> Float[Tensor, "point row coil"]:
        for part in self.system.parts:
            for use in (use for use in uses_of(part.rig, Effect) if not use.effect.is_linear):
                raise InvalidInput(
                    f"actuation needs a field proportional to the currents; with {use.label} that of {use.place} is not"
                )
        n = len(self.system.coils)
        steps_A = torch.cat((torch.zeros(1, n), torch.eye(n))).to(torch.float64)
        field_T = self._sum(RoomField.field_T, self._best, steps_A)
        columns = field_T[1:] - field_T[:1]
        if has_gradient:
            gradient = self._gradient_T_per_m(steps_A)
            columns = torch.cat((columns, independent_entries(gradient[1:] - gradient[:1])), dim=-1)
        return columns.movedim(0, -1)

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
        currents: Any,
        level: float,
        what: Answer,
    ) -> tuple[Any, Any]:
        check_level(level)
        draws, current_A, n_axes = self.system.draws(), self._currents_A(currents), 1 + len(what.axes)
        sampled = self._sum(quantity, draws, current_A[..., None, :])
        tails = torch.tensor([0.5 - 0.5 * level, 0.5 + 0.5 * level], dtype=sampled.dtype)
        batch, rest = current_A.shape[:-1], sampled.shape[-n_axes:]
        n = max((value.shape[0] for values in draws for value in values.values() if value.ndim), default=1)
        ends = torch.quantile(sampled.expand(*batch, n, *rest), tails, dim=-n_axes - 1)
        lower, upper = (
            self.points.answer(end, what.end_of_interval(which, level))
            for which, end in zip(("lower", "upper"), ends, strict=True)
        )
        return lower, upper

    def _currents(self, matrix: Tensor, target: Tensor, most_A: Any) -> Any:
        axes = {"coil": self.system.coils}
        return self.points.answer(self._best_currents(matrix, target, most_A), Answer("current", "A", axes))

    def _best_currents(
        self, matrix: Tensor, target: Tensor, most_A: Any
    ) -> Float[Tensor, "*batch point coil"]:
        if most_A is None:
            return minimum_norm_currents(matrix, target)
        rule = "largest currents must be one number, or one for each coil"
        most_of_each_A = given_numbers(most_A, rule).to(torch.float64)
        return bounded_currents(matrix, target, most_of_each_A.expand(len(self.system.coils)))
