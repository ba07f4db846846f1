"""A correction of where a mover stands after its last move: play, overshoot, loose mounts, and clocks that do not agree."""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, limit_of_number
from estimator.effects.stages import MotionEffect
from estimator.frames import Transform, rotation_from_vector
from estimator.tensors import Tensor, torch

LEAST_LENGTH_M = 1e-9
BY_MOVE, BY_SIDE, BY_MOVE_AND_TIME = 1, 2, 3


class MovesRemembered(Correction, MotionEffect):
    """The mover stands elsewhere, and is turned, by an amount that depends on the move that led there.

    Degree 1 is proportional to the last move, degree 2 depends on the side from which each axis came, and degree 3 is proportional to the
    last move and to time, as of two clocks that run apart.
    """

    name: ClassVar[str] = "moves_remembered"
    words: ClassVar[str] = "where the mover stands depends on the move that led there"
    unit: ClassVar[str] = "m"
    highest: ClassVar[int] = 3

    def terms(self, degree: int) -> tuple[str, ...]:
        """What errs after a move along which axis: `z_after_x`; `rz_after_x` turns, as an arc at the reach."""
        kinds = ("", "r") if degree == BY_SIDE else ("",)
        return tuple(f"{kind}{axis}_after_{way}" for kind in kinds for axis in "xyz" for way in "xyz")

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """A typical move, and the radius of the arcs."""
        return tuple(
            shape(key, "m", 0.0, 100.0 * extent.reach_m, is_fixed=True) for key in ("move_m", "reach_m")
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The rms of the last moves; the reach of the session."""
        rms_m = float(circumstances.last_move_m(place).square().sum(-1).mean().sqrt())
        numbers = {"move_m": rms_m, "reach_m": circumstances.reach_m}
        return ({key: float(f"{max(number, LEAST_LENGTH_M):.6g}") for key, number in numbers.items()},)

    def broken_rule(self, values: dict[str, float]) -> tuple[str, str] | None:  # type: ignore[override]
        """The move and the reach must be positive lengths."""
        return next(((key, "must be > 0") for key in ("move_m", "reach_m") if values[key] <= 0.0), None)

    def beyond_the_moment(self, key: str) -> str | None:
        """The way to a position is history."""
        return "how the mover came to where it stands"

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover moved."""
        return bool((circumstances.last_move_m(place) != 0.0).any())

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different moves determines."""
        n_moves = len(torch.unique((1e6 * circumstances.last_move_m(place)).round(), dim=0))
        return limit_of_number(self, n_moves, "different moves")

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """The last move, the side from which each axis came, and the last move times the share of the session that has gone."""
        move_m = circumstances.last_move_m(mover)
        gone = (circumstances.hours / circumstances.duration_h)[:, None]
        return torch.cat((move_m, circumstances.approach(mover), gone * move_m), dim=-1)

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        move_m, side, late_move_m = columns.unflatten(-1, (3, 3)).unbind(-2)
        typical_m, reach_m = (theta[key].flatten()[0] for key in ("move_m", "reach_m"))
        by_degree = {BY_MOVE: move_m / typical_m, BY_SIDE: side, BY_MOVE_AND_TIME: late_move_m / typical_m}
        shift_m, rotation = torch.zeros_like(move_m), pose.rotation
        for degree, amplitude in self.amplitudes(theta).items():
            matrices = amplitude.unflatten(-1, (-1, 3, 3))
            shift_m = shift_m + by_degree[degree] @ matrices[..., 0, :, :].mT
            if degree == BY_SIDE:
                turn_rad = by_degree[degree] @ matrices[..., 1, :, :].mT / reach_m
                rotation = rotation @ rotation_from_vector(turn_rad)
        return Transform(rotation, pose.translation_m + shift_m)
