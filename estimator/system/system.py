"""Several calibrated coils on several arms as one magnet: field, gradient, force, intervals, and the currents for what is wanted.

Each coil's model comes from the calibration that measured it, so arms that were calibrated one coil at a time are combined (paper, eq
14-17, 22). Adding them up supposes that no coil drives another; `estimator.system.superposition` tests that on readings with all coils on.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.calibration.result import INTERVAL_DRAWS, Calibration
from estimator.effects.base import Effect, RoomEffect
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

Motion = Mapping[str, Float[Tensor, "... 6"]]


@dataclass(frozen=True)
class System:
    """Coils of one room, each as a calibration found it.

    All calibrations must give their poses in the same world frame, such as that of the sensor they share. A constant field of the room
    is taken from the first calibration that has one.

    Attributes:
        calibrations: By name of the coil; the order is that of the currents.

    Examples:
        >>> from estimator import calibrate, load_session
        >>> system = System.of(calibrate(load_session("arm1.zarr")), calibrate(load_session("arm2.zarr")))  # doctest: +SKIP
        >>> here = system.at(points_m, {"arm1": joints1_rad, "arm2": joints2_rad})  # doctest: +SKIP
        >>> here.field_T(system.currents({"coil1": 3.0}))  # doctest: +SKIP
    """

    calibrations: Mapping[str, Calibration]

    def __post_init__(self) -> None:
        if not self.calibrations:
            raise InvalidInput("system must have at least one coil; received none")
        for name, calibration in self.calibrations.items():
            known = [coil.name for coil in calibration.rig.coils]
            if name not in known:
                raise InvalidInput(
                    f"system must name coils of their calibrations; rig {calibration.rig.name!r} has {', '.join(known)}, not {name!r}"
                )

    @classmethod
    def of(cls, *calibrations: Calibration) -> System:
        """The coils that were on while each calibration's readings were taken.

        Raises:
            InvalidInput: A coil was on in two calibrations; then `System` must be told whose model to use.
        """
        chosen: dict[str, Calibration] = {}
        for calibration in calibrations:
            was_on = (calibration.observations.current_A != 0.0).any(dim=0).tolist()
            for coil, on in zip(calibration.rig.coils, was_on, strict=True):
                if on and coil.name in chosen:
                    raise InvalidInput(f"system: {coil.name} must be on in one calibration; received two")
                if on:
                    chosen[coil.name] = calibration
        return cls(chosen)

    @property
    def coils(self) -> tuple[str, ...]:
        """Names of the coils, in the order of the currents."""
        return tuple(self.calibrations)

    @cached_property
    def parts(self) -> tuple[Calibration, ...]:
        """Each calibration once, without the coils that another one describes."""
        parts: list[Calibration] = []
        has_background = False
        for whole in {id(calibration): calibration for calibration in self.calibrations.values()}.values():
            coils = tuple(c for c in whole.rig.coils if self.calibrations.get(c.name) is whole)
            left_out = {coil.name for coil in whole.rig.coils} - {coil.name for coil in coils}
            effects = [cause for cause in whole.rig.effects if cause.place not in left_out]
            background = [use.cause for use in uses_of(whole.rig, RoomEffect) if use.effect.is_background]
            if has_background:
                effects = [cause for cause in effects if cause not in background]
            rig = replace(whole.rig, coils=coils, effects=tuple(effects))
            has_background = has_background or bool(background)
            parts.append(replace(whole, rig=rig))
        return tuple(parts)

    def currents(self, currents_A: Mapping[str, float]) -> Float[Tensor, " coil"]:
        """Currents by name as a vector; coils that are not named are off.

        Raises:
            InvalidInput: A name is no coil of the system.
        """
        for name in currents_A:
            if name not in self.calibrations:
                raise InvalidInput(
                    f"currents must name coils of the system ({', '.join(self.coils)}); received {name!r}"
                )
        return torch.tensor([float(currents_A.get(name, 0.0)) for name in self.coils], dtype=torch.float64)

    def at(self, points_m: Float[Tensor, "point 3"], motion: Motion | None = None) -> SystemField:
        """The system with its arms where they are said to be.

        Args:
            points_m: Points in the world frame.
            motion: Per mover its joint values or displacement, six numbers or six for each point. What is computed from the result may be
                differentiated in points and motion. A mover that reports displacements stands at zero where it is not named.
        Raises:
            InvalidInput: An unknown mover, or one that carries a coil and whose stand is not said.
        """
        motion = motion or {}
        known = {mover.name for part in self.parts for mover in part.rig.movers}
        for name in motion:
            if name not in known:
                raise InvalidInput(
                    f"motion must name movers of the system ({', '.join(sorted(known)) or 'none'}); received {name!r}"
                )
        rooms = []
        for part in self.parts:
            own = {mover.name: motion[mover.name] for mover in part.rig.movers if mover.name in motion}
            rooms.append(part.room(points_m, own))
        return SystemField(self, tuple(rooms))

    def draws(self) -> tuple[Values, ...]:
        """Draws of the posterior of each part, equally many.

        Calibrations that were run with the same seed share their random numbers, so the draws of each part are shuffled.
        """
        n = min(INTERVAL_DRAWS, *(part.log_prob.size for part in self.parts))
        found = []
        for i, part in enumerate(self.parts):
            order = torch.randperm(n, generator=torch.Generator().manual_seed(i))
            values = part.draw_values(n)
            found.append({name: value[order] if value.ndim else value for name, value in values.items()})
        return tuple(found)


@dataclass(frozen=True)
class SystemField:
    """A system at fixed points, its arms at rest; made by `System.at`. Numbers are NaN at points inside a winding.

    Attributes:
        system: The calibrated coils.
        rooms: Where they stand, part by part.
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
        """Lower and upper end of the credible interval of each component; calibrations err independently of each other.

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
            moment_A_m2: Moment in the world frame, one or one for each point.
            current_A: Currents.
        """
        return (moment_A_m2[..., None, :] @ self.gradient_T_per_m(current_A))[..., 0, :]

    def actuation(self, has_gradient: bool = True) -> Float[Tensor, "point row coil"]:
        """Field and gradient per ampere of each coil: rows Bx, By, Bz, then dBx/dx, dBx/dy, dBx/dz, dBy/dy, dBy/dz.

        Args:
            has_gradient: False leaves the last five rows out and costs a third.
        Raises:
            InvalidInput: A core saturates, so that the field is not proportional to the current.
        """
        for part in self.system.parts:
            for use in (use for use in uses_of(part.rig, Effect) if not use.effect.is_linear):
                raise InvalidInput(
                    f"actuation needs a field proportional to the currents; {use.label} makes that of {use.place} another"
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
        """Currents that make a field, point by point: each row is for its point alone.

        Args:
            field_T: Wanted field; what is there without current is made up for.
            most_A: Largest magnitude of the currents, of all or of each; then nothing can be differentiated. Without it the currents are
                those of minimum norm.
        Returns: Currents that come closest, in ampere; `actuation` says what they make.
        """
        wanted_T = field_T - self.field_T(self._off())
        return self._currents(self.actuation(has_gradient=False), wanted_T, most_A)

    def currents_for_force(
        self,
        moment_A_m2: Float[Tensor, "*#batch 3"],
        force_N: Float[Tensor, "*batch point 3"],
        most_A: Float[Tensor, " coil"] | float | None = None,
    ) -> Float[Tensor, "*batch point coil"]:
        """Currents that pull a dipole of constant moment with a force, point by point; arguments as in `currents_for_field`."""
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
        """A quantity of the field, added over the parts."""
        total = torch.zeros((), dtype=torch.float64)
        for room, own in zip(self.rooms, values, strict=True):
            columns = [self.system.coils.index(coil.name) for coil in room.rig.coils]
            total = total + quantity(room, own, current_A[..., columns])
        return total

    def _interval(
        self,
        quantity: Callable[[RoomField, Values, Tensor], Tensor],
        current_A: Tensor,
        level: float,
        n_axes: int,
    ) -> tuple[Tensor, Tensor]:
        if not 0.0 < level < 1.0:
            raise InvalidInput(f"level must lie between 0 and 1; received {level}")
        draws = self.system.draws()
        found = self._sum(quantity, draws, current_A[..., None, :])
        tails = torch.tensor([0.5 - 0.5 * level, 0.5 + 0.5 * level], dtype=found.dtype)
        batch, rest = current_A.shape[:-1], found.shape[-n_axes:]
        n = max((value.shape[0] for own in draws for value in own.values() if value.ndim), default=1)
        lower, upper = torch.quantile(found.expand(*batch, n, *rest), tails, dim=-n_axes - 1)
        return lower, upper

    def _currents(
        self, matrix: Tensor, target: Tensor, most_A: Float[Tensor, " coil"] | float | None
    ) -> Tensor:
        if most_A is None:
            return minimum_norm_currents(matrix, target)
        bound_A = torch.as_tensor(most_A, dtype=torch.float64).expand(len(self.system.coils))
        return bounded_currents(matrix, target, bound_A)
