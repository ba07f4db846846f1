"""Corrections by what was before: the currents and the fields of the last readings, and the side that a move along one direction left."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import LEAST_STEP, Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, limit_of_number
from estimator.effects.stages import MotionEffect, OneCoilCurrent, ReadingEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.tensors import Tensor, torch

N_DIRECTIONS = 48  # of a half sphere: any direction is within 15 degrees of one of them
LEAST_MOVE = 1e-3  # of a typical move: less is rounding
LEAST_LENGTH_M = 1e-9
UNIT = ("unit_x", "unit_y", "unit_z")


class SidesRemembered(Correction, MotionEffect):
    """What is loose along one direction: the mover stands, and is turned, to the side that its last move along that direction left.

    The direction need not be an axis of the mover. It is one of a set that covers the half sphere.
    """

    name: ClassVar[str] = "sides_remembered"
    words: ClassVar[str] = "the mover stands on the side that its last move along some direction left"
    unit: ClassVar[str] = "m"
    highest: ClassVar[int] = 1

    def terms(self, degree: int) -> tuple[str, ...]:
        """Shifts, and turns as arcs at the reach."""
        return ("x", "y", "z", "rx", "ry", "rz")

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The direction, and the radius of the arcs."""
        reach_m = shape("reach_m", "m", 0.0, 100.0 * extent.reach_m, is_fixed=True)
        return (*(shape(key, "1", -1.0, 1.0, is_fixed=True) for key in UNIT), reach_m)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """One for each way in which the moves of the session can be divided; the first of alike ones."""
        _, first = _distinct_rows(_sides(circumstances, place).T)
        reach_m = float(f"{max(circumstances.reach_m, LEAST_LENGTH_M):.6g}")
        units = directions()[first.tolist()].tolist()
        return tuple({**dict(zip(UNIT, unit, strict=True)), "reach_m": reach_m} for unit in units)

    def factors(
        self, circumstances: Circumstances, place: str, starts: Sequence[dict[str, float]]
    ) -> Float[Tensor, "start reading"]:
        """The sides, with those of the first start for plus."""
        units = circumstances.hours.new_tensor([[start[key] for key in UNIT] for start in starts])
        sides = _sides(circumstances, place)[:, _nearest(units)].T
        return sides * sides[0]

    def broken_rule(self, values: dict[str, float]) -> tuple[str, str] | None:  # type: ignore[override]
        """The reach must be a length."""
        return ("reach_m", "must be > 0") if values["reach_m"] <= 0.0 else None

    def beyond_the_moment(self, key: str) -> str | None:
        """The way to a position is history."""
        return "how the mover came to where it stands"

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover moved."""
        return bool((circumstances.last_move_m(place) != 0.0).any())

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of readings determines; 0 where all moves left the mover on one side."""
        if bool((_sides(circumstances, place) == 1.0).all()):
            return Limit(0, "the mover went to one side only; come to some places from the other")
        return limit_of_number(self, len(circumstances), "readings")

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """The side along each direction of the set."""
        return _sides(circumstances, mover)

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        unit = torch.stack([theta[key] for key in UNIT], dim=-1)
        side = columns.T[_nearest(unit)]
        [amplitude] = self.amplitudes(theta).values()
        shift_m, arc_m = (side[..., None] * amplitude[..., None, :]).split(3, dim=-1)
        turn = rotation_from_vector(arc_m / theta["reach_m"].flatten()[0])
        return Transform(pose.rotation @ turn, pose.translation_m + shift_m)


class CurrentRemembered(Correction, OneCoilCurrent):
    """The field of a coil lags behind its current, or depends on its sign or on where it came from.

    Degree 1 differs by the sign of the current, degree 2 by the side from which it came, degree 3 goes with the reading before, degree 4
    with the current from which it last turned back.
    """

    name: ClassVar[str] = "current_remembered"
    is_linear: ClassVar[bool] = False
    words: ClassVar[str] = "the coil's field depends on the sign of its current and on the currents before"
    unit: ClassVar[str] = "1"
    highest: ClassVar[int] = 4

    def terms(self, degree: int) -> tuple[str, ...]:
        """Share of the largest current of the session."""
        return ("share",)

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Unit of the amplitudes: the largest current of the session, in A."""
        return (shape("range_A", "A", 0.0, 100.0 * extent.largest_current_A, is_fixed=True),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Largest current of this session, in A."""
        return ({"range_A": float(f"{circumstances.largest_current_A:.6g}")},)

    def broken_rule(self, values: dict[str, float]) -> tuple[str, str] | None:  # type: ignore[override]
        """The largest current is positive."""
        return ("range_A", "must be > 0") if values["range_A"] <= 0.0 else None

    def beyond_the_moment(self, key: str) -> str | None:
        """But for the sign, the way to a current is history."""
        return None if key.startswith("degree1") or key == "range_A" else "the currents before"

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree; none where the current never changed."""
        current_A = circumstances.observations.history.current_A[:, _coil(circumstances, place)]
        n = len(torch.unique((current_A / (LEAST_STEP * circumstances.largest_current_A)).round()))
        if n > 1:
            return Limit(self.highest)
        return Limit(0, "all readings are at one current; measure at others, of both signs")

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil, in A."""
        range_A = theta["range_A"].flatten()[0]
        history_A = circumstances.observations.history.current_A[:, coil]
        before_A = torch.nn.functional.pad(history_A, (1, 0))[:-1]
        step_A = history_A - before_A
        is_step = step_A.abs() > LEAST_STEP * circumstances.largest_current_A
        last = torch.cummax(torch.arange(len(history_A), device=history_A.device) * is_step, dim=0).values
        row = circumstances.observations.row
        by_degree = {
            1: current_A.abs() / range_A,
            2: torch.where(is_step.any(), torch.sign(step_A[last]), torch.zeros_like(step_A))[row],
            3: (before_A - history_A)[row] / range_A,
            4: circumstances.last_turn_A(coil) / range_A,
        }
        share = current_A.new_zeros(())
        for degree, amplitude in self.amplitudes(theta).items():
            if degree == 1 or not circumstances.is_moment:
                share = share + amplitude * by_degree[degree]
        return current_A + range_A * share


class FieldRemembered(Correction, ReadingEffect):
    """A sensor shows something of the fields that it read before, as of eddy currents, a slow filter, or a clock that runs apart.

    Degree 1 is a share of the change since its last reading, degree 2 the same growing with time, degrees 3 and 4 shares of the changes
    before.
    """

    name: ClassVar[str] = "field_remembered"
    words: ClassVar[str] = "the sensor shows something of the fields that it read before"
    unit: ClassVar[str] = "1"
    highest: ClassVar[int] = 4

    def terms(self, degree: int) -> tuple[str, ...]:
        """A share of all components."""
        return ("share",)

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """No fixed numbers."""
        return ()

    def beyond_the_moment(self, key: str) -> str | None:
        """What was shown before is history."""
        return "the readings before"

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether readings follow one another in time."""
        return not circumstances.is_moment

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of the sensor's readings determines."""
        own = circumstances.is_of(place)
        return limit_of_number(self, int(own.sum()), "readings one after another")

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read; what was read before is what was recorded, and what was not counts as no change."""
        amplitudes = self.amplitudes(theta)
        history_T = circumstances.observations.history.field_sensor_T.to(field_sensor_T.dtype)
        if not amplitudes or bool(torch.isnan(history_T).all()):
            return field_sensor_T
        rows = [_before(circumstances, sensor)]
        for _ in range(2):
            rows.append(rows[0][rows[-1]])
        row = circumstances.observations.row
        before_T = [history_T[previous[row]] for previous in rows]
        newest_T = torch.where(torch.isnan(before_T[0]), field_sensor_T, before_T[0]) - field_sensor_T
        late = (circumstances.hours / circumstances.duration_h)[:, None]
        older_T = [(before_T[i] - before_T[i - 1]).nan_to_num() for i in (1, 2)]
        by_degree = {1: newest_T, 2: late * newest_T, 3: older_T[0], 4: older_T[1]}
        for degree, amplitude in amplitudes.items():
            field_sensor_T = field_sensor_T + amplitude[..., None, :] * by_degree[degree]
        return field_sensor_T


def directions() -> Float[Tensor, "direction 3"]:
    """Directions that cover the half sphere evenly, on a spiral of the golden angle."""
    height = (torch.arange(N_DIRECTIONS, dtype=torch.float64) + 0.5) / N_DIRECTIONS
    azimuth = math.pi * (3.0 - math.sqrt(5.0)) * torch.arange(N_DIRECTIONS, dtype=torch.float64)
    across = torch.sqrt(1.0 - height**2)
    units = torch.stack((across * torch.cos(azimuth), across * torch.sin(azimuth), height), dim=-1)
    rounded: Tensor = (1e6 * units).round() / 1e6
    return rounded


def _nearest(unit: Float[Tensor, "*batch 3"]) -> Tensor:
    """Number of the direction of the set that is nearest."""
    return (unit @ directions().to(unit).T).argmax(-1)


def _sides(circumstances: Circumstances, mover: str) -> Float[Tensor, "reading direction"]:
    """Sign of the last move along each direction; plus before the first, as after a way forwards. A moment has no side."""
    if circumstances.is_moment:
        return circumstances.hours.new_zeros(len(circumstances), N_DIRECTIONS)
    move_m = circumstances.moves_m(mover)
    length_m = move_m.norm(dim=-1)
    typical_m = float(length_m.square().mean().sqrt())
    along_m = move_m @ directions().to(move_m).T
    is_move = along_m.abs() > LEAST_MOVE * max(typical_m, LEAST_LENGTH_M)
    last = torch.cummax(torch.arange(len(move_m), device=move_m.device)[:, None] * is_move, dim=0).values
    side = torch.where(is_move, torch.sign(along_m), torch.ones_like(along_m))
    return torch.gather(side, 0, last)[circumstances.observations.row]


def _distinct_rows(rows: Float[Tensor, "row column"]) -> tuple[Tensor, Tensor]:
    """The distinct of some rows, up to their sign, and the number of the first of each."""
    signed = rows * rows[:, :1]
    distinct, which = torch.unique(signed, dim=0, return_inverse=True)
    number = torch.arange(len(rows), device=rows.device)
    first = torch.full_like(number[: len(distinct)], len(rows)).scatter_reduce(0, which, number, "amin")
    return distinct, first.sort().values


def _before(circumstances: Circumstances, sensor: str) -> Tensor:
    """Row of the history of the reading that a sensor took before each; its own where none was."""
    history = circumstances.observations.history
    own = (history.sensor == [s.name for s in circumstances.rig.sensors].index(sensor)).nonzero().flatten()
    row = torch.arange(len(history), device=history.device)
    row[own[1:]] = own[:-1]
    return row


def _coil(circumstances: Circumstances, name: str) -> int:
    return [coil.name for coil in circumstances.rig.coils].index(name)
