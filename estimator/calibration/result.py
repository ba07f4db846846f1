"""A calibrated model: the field anywhere, with credible intervals, and its files on disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsFloat, TypeVar, cast

import numpy as np
from jaxtyping import Float, Int

from estimator.calibration.files import Parts, read_parts, write_parts
from estimator.calibration.many_points import ends_at_many, tails
from estimator.devices import numpy_of
from estimator.effects.stages import RoomEffect
from estimator.effects.use import uses_of
from estimator.errors import InvalidInput, check_known, cut, quoted
from estimator.export.formats import Exportable
from estimator.export.magnet import Magnet
from estimator.glance import Shown
from estimator.model.room_field import RoomField, some_at_a_time
from estimator.points import FIELD, GRADIENT, given_motion, given_points
from estimator.readings.observations import Observations
from estimator.rig.bodies import MotionKind
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch
from estimator.units import LARGEST

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INTERVAL_DRAWS = 400
Kind = TypeVar("Kind")  # of points: answers are of the same


@dataclass(frozen=True, repr=False)
class Calibration(Shown, Exportable):
    """The result of a calibration.

    Attributes:
        rig: The rig with its priors.
        observations: The readings it was made from, validation included.
        best: Every number of the rig at the maximum of the posterior, with the most probable whole loop counts.
        draws: Posterior draws of every free parameter, walker by step.
        log_prob: Log posterior density of the draws, up to a constant. Draws that were widened keep the density of the draws before.
        summary_json: Content of `summary.json`.
    """

    rig: Rig
    observations: Observations
    best: Mapping[str, float]
    draws: Mapping[str, np.ndarray]
    log_prob: np.ndarray
    summary_json: Mapping[str, Any]

    def field(
        self, points_m: Kind, currents_A: Mapping[str, float], motion: Mapping[str, Any] | None = None
    ) -> Kind:
        """Flux density of the calibrated model in the world frame, in tesla.

        Args:
            points_m: Points in the world frame, x, y, z last: one or many, as a list, a NumPy array, a tensor or an `xarray.DataArray`. The
                prediction is made on the device and in the precision of a tensor.
            currents_A: Current of each coil by name; coils that are not named are off.
            motion: The six numbers of each mover's columns. A mover that reports displacements defaults to zero, its reference
                configuration; any other mover that carries a coil must be named.
        Returns: Bx, By, Bz in the kind that was given; NaN at points inside a winding.
        Raises:
            InvalidInput: An unknown coil or mover, a mover without its motion, or a number that is not finite or beyond `LARGEST`.
        Examples:
            >>> calibration.field([0.0, 0.0, 0.05], {"coil1": 2.0})  # doctest: +SKIP
            [1.2e-05, -3.0e-06, 0.00214]
        """
        given = given_points(points_m)
        room = self.room(given.points_m, motion)
        field_T = room.field_T(self.best_values(given.points_m), self.currents(currents_A, given.points_m))
        return given.answer(field_T, FIELD)

    def gradient(
        self, points_m: Kind, currents_A: Mapping[str, float], motion: Mapping[str, Any] | None = None
    ) -> Kind:
        """dB_i / dx_j of the calibrated model in the world frame, in T/m, with two more axes; arguments as in `field`.

        It is symmetric and traceless, as in any source-free region.
        """
        given = given_points(points_m)
        room = self.room(given.points_m, motion)
        values, current_A = self.best_values(given.points_m), self.currents(currents_A, given.points_m)
        return given.answer(room.gradient_T_per_m(values, current_A), GRADIENT)

    def field_interval(
        self,
        points_m: Kind,
        currents_A: Mapping[str, float],
        level: float = 0.9,
        motion: Mapping[str, Any] | None = None,
    ) -> tuple[Kind, Kind]:
        """Credible interval of each field component, from the uncertainty that data and priors leave in the model.

        Args:
            points_m, currents_A, motion: As in `field`.
            level: Probability inside the interval, 0 < level < 1.
        Returns: Lower and upper ends in tesla, from 400 posterior draws, evenly spaced in the order of the steps: always the same ones.
            By their number, each end is known to a tenth of the posterior's standard deviation (for a level of 0.9).
        Raises:
            InvalidInput: Level outside (0, 1), or as in `field`.
        """
        return self._interval(points_m, currents_A, level, motion, is_gradient=False)

    def gradient_interval(
        self,
        points_m: Kind,
        currents_A: Mapping[str, float],
        level: float = 0.9,
        motion: Mapping[str, Any] | None = None,
    ) -> tuple[Kind, Kind]:
        """Credible interval of each dB_i / dx_j, in T/m; as `field_interval`."""
        return self._interval(points_m, currents_A, level, motion, is_gradient=True)

    def _interval(
        self,
        points: Kind,
        currents_A: Mapping[str, float],
        level: float,
        motion: Mapping[str, Any] | None,
        is_gradient: bool,
    ) -> tuple[Kind, Kind]:
        check_level(level)
        given = given_points(points)
        points_m, moved = given.points_m, given_motion(motion, given.points_m)
        room, current_A = self.room(points_m, moved), self.currents(currents_A, points_m)
        draws, what = self.draw_values(INTERVAL_DRAWS, points_m), GRADIENT if is_gradient else FIELD
        n_axes = len(what.axes)

        def of_draws(room: RoomField, draws: Mapping[str, Tensor]) -> Tensor:
            predict = room.gradient_T_per_m if is_gradient else room.field_T
            return some_at_a_time(
                lambda drawn: predict(drawn, current_A), dict(draws), len(room.points_m), 1 + n_axes
            )

        def at_some(which: Int[np.ndarray, " some"], draws: Mapping[str, Tensor]) -> np.ndarray:
            rows = {name: numbers[which] if numbers.dim() > 1 else numbers for name, numbers in moved.items()}
            n_draws = max(len(value) for value in draws.values() if value.dim())
            said = of_draws(self.room(points_m[which], rows), draws)
            return numpy_of(said.expand(n_draws, len(which), *[3] * n_axes))

        many = ends_at_many(at_some, draws, numpy_of(room.is_near), level)
        if many is None:
            ends = self.ends(of_draws(room, draws), (len(points_m), *[3] * n_axes), level)
        else:
            ends = torch.from_numpy(many[0]).to(points_m), torch.from_numpy(many[1]).to(points_m)
        lower, upper = (
            given.answer(end, what.end_of_interval(which, level))
            for which, end in zip(("lower", "upper"), ends, strict=True)
        )
        return lower, upper

    def coils_alone(self) -> Calibration:
        """This calibration without what is there without current, such as the Earth's field, whose uncertainty a coil has no part in.

        Where no sensor turned, the field of the room is known only together with the zeros of the sensors, so that intervals of both
        together are far wider than those of the coils.
        """
        background = {use.cause for use in uses_of(self.rig, RoomEffect) if use.effect.is_background}
        effects, corrections = (
            tuple(cause for cause in acting if cause not in background)
            for acting in (self.rig.effects, self.rig.corrections)
        )
        return replace(self, rig=replace(self.rig, effects=effects, corrections=corrections))

    def ends(
        self, values: Float[Tensor, "..."], shape: tuple[int, ...], level: float
    ) -> tuple[Float[Tensor, "..."], Float[Tensor, "..."]]:
        """Ends of the central interval of a shape, over values for `draw_values(INTERVAL_DRAWS)` on the first axis."""
        n_draws = min(INTERVAL_DRAWS, self.log_prob.size)
        values = values.expand(n_draws, *shape)  # no batch where no coil is free
        # Takes a third of the time of torch.quantile, which sorts.
        ends = np.quantile(numpy_of(values), tails(level), axis=0)
        lower, upper = torch.from_numpy(ends).to(values)
        return lower, upper

    def room(self, points_m: Float[Tensor, "point 3"], motion: Mapping[str, Any] | None) -> RoomField:
        """The coils with each mover in one pose, or in one pose per point, ready for any values of the rig and any currents.

        Args:
            points_m: Points in the world frame.
            motion: As in `field`, or a row of six numbers for each point.
        Raises:
            InvalidInput: As in `field`.
        """
        motion = given_motion(motion, points_m)
        carriers = {coil.carried_by for coil in self.rig.coils}
        for mover in self.rig.movers:
            if mover.name in motion:
                numbers = motion[mover.name]
                if numbers.shape[-1:] != (6,) or not bool((numbers.abs() <= LARGEST).all()):
                    received = cut(str(numbers.tolist()), 200)
                    raise InvalidInput(
                        f"motion of {mover.name} must be six numbers between {-LARGEST:g} and {LARGEST:g}; received {received}"
                    )
            elif mover.name in carriers and mover.motion is not MotionKind.DISPLACEMENT:
                raise InvalidInput(
                    f"motion of {mover.name} must be given ({', '.join(mover.columns)}): it carries a coil; received none"
                )
        if not torch.isfinite(points_m).all():
            raise InvalidInput("points must be finite; received NaN or infinity among them")
        return RoomField(self.rig, self.best_values(points_m), points_m, motion)

    def best_values(self, like: Tensor | None = None) -> dict[str, Tensor]:
        """Every number of the rig at the maximum of the posterior, as `RoomField` takes them.

        Args:
            like: A tensor on the device and in the precision that are wanted; double precision on the processor by default.
        """
        like = _kind(like)
        return {name: like.new_tensor(value) for name, value in self.best.items()}

    def draw_values(self, most: int, like: Tensor | None = None) -> dict[str, Tensor]:
        """Every number of the rig for evenly spaced draws of the posterior, in the order of the steps; `like` as in `best_values`."""
        n_draws = self.log_prob.size
        index = np.linspace(0, n_draws - 1, min(most, n_draws)).astype(int)
        chosen = {name: torch.from_numpy(array.T.reshape(-1)[index]) for name, array in self.draws.items()}
        coordinates = Coordinates(self.rig, integer_counts=True)
        like = _kind(like)
        return {
            name: value.to(like) for name, value in coordinates.values(coordinates.vector(chosen)).items()
        }

    def summary(self) -> Mapping[str, Any]:
        """Parameters with credible intervals, loop counts, errors, coverage and provenance: the content of `summary.json`."""
        return self.summary_json

    def plot_field(self, coil: str | None = None) -> Figure:
        """Field of one ampere in the plane through a coil's axis, and its uncertainty (`plots.field_plane`).

        Args:
            coil: Its name; the first where left out.
        Raises:
            InvalidInput: The rig has no such coil, or it never carried current.
        Examples:
            >>> calibration.plot_field().savefig("field.png")  # doctest: +SKIP
        """
        return self._shown.plot_field(self, coil)

    def plot_residuals(self, ax: Axes | None = None) -> Axes:
        """Residuals of the fit over the noise beside the normal density (`plots.residual_histogram`)."""
        return self._shown.plot_residuals(self, ax)

    def plot_parameters(self, ax: Axes | None = None) -> Axes:
        """Prior and posterior of every free parameter: what the data taught (`plots.interval_summary`)."""
        return self._shown.plot_parameters(self, ax)

    def magnet(self) -> Magnet:
        """What exports write: the coils."""
        return Magnet.of(self)

    def save(self, folder: Path | str) -> None:
        """Write `posterior.zarr` (ArviZ groups for `xarray.open_datatree`), then `summary.json`, which marks the result as complete.

        Raises:
            InvalidInput: The folder cannot be written, or files of somebody else have these names in it.
        """
        parts = Parts(self.rig, self.observations, self.best, self.draws, self.log_prob, self.summary_json)
        write_parts(parts, Path(folder))

    @classmethod
    def load(cls, folder: Path | str) -> Calibration:
        """Read what `save` wrote.

        Raises:
            InvalidInput: The folder holds no finished calibration.
            CorruptStore: A file in it is damaged.
        """
        return cls(*read_parts(Path(folder)))

    def currents(self, currents_A: Mapping[str, float], like: Tensor | None = None) -> Float[Tensor, " coil"]:
        """Currents in the order of the rig's coils; those that are not named are off. `like` as in `best_values`."""
        names = [coil.name for coil in self.rig.coils]
        if not isinstance(cast(object, currents_A), Mapping):
            example = {names[0]: 2.0}
            raise InvalidInput(
                f"currents must be given by coil, such as {example}; received {quoted(currents_A)}"
            )
        check_known("currents must name coils of the rig", currents_A, names)
        for name, current_A in cast(Mapping[str, object], currents_A).items():
            if not (isinstance(current_A, SupportsFloat) and abs(float(current_A)) <= LARGEST):
                rule = f"current of {name} must be a number between {-LARGEST:g} and {LARGEST:g}"
                raise InvalidInput(f"{rule}; received {quoted(current_A)}")
        return _kind(like).new_tensor([float(currents_A.get(name, 0.0)) for name in names])


def _kind(like: Tensor | None) -> Tensor:
    """A tensor on the device and in the precision that are wanted."""
    return torch.empty(0, dtype=torch.float64) if like is None else like


def check_level(level: float) -> None:
    """Refuse a level of an interval that is no probability.

    Raises:
        InvalidInput: It is not between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        raise InvalidInput(f"level must lie between 0 and 1; received {level}")
