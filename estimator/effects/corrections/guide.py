"""A correction of where a mover stands: guides and screws whose errors are smooth functions of the position along them."""

from __future__ import annotations

import math
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, limit_of_number
from estimator.effects.stages import MotionEffect
from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion
from estimator.tensors import Tensor, torch

STRAIGHT_DEGREE = 3  # up to which a guide may bend across itself; beyond, only the screw's own error is asked
SMALLEST_SPAN = 1e-3  # of the widest: along shorter ways nothing depends on the position
LEAST_SPAN_M = 1e-6


class GuideErrors(Correction, MotionEffect):
    """Along each axis the mover errs by cosines of half waves over the way that it went; beyond, they repeat as in a mirror."""

    name: ClassVar[str] = "guide_errors"
    words: ClassVar[str] = "the mover errs smoothly along its guides"
    unit: ClassVar[str] = "m"
    highest: ClassVar[int] = 12

    def terms(self, degree: int) -> tuple[str, ...]:
        """What errs along which axis: `z_along_x`."""
        is_bent = degree <= STRAIGHT_DEGREE
        return tuple(f"{axis}_along_{way}" for way in "xyz" for axis in ("xyz" if is_bent else way))

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Beginning and length of the mover's way along each axis, in m."""
        ends_m = 100.0 * extent.reach_m
        return tuple(
            quantity
            for axis in "xyz"
            for quantity in (
                shape(f"from_{axis}_m", "m", -ends_m, ends_m, is_fixed=True),
                shape(f"span_{axis}_m", "m", 0.0, 2.0 * extent.reach_m, is_fixed=True),
            )
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The box that the mover went through."""
        at_m = self._at_m(circumstances, place)
        low_m, span_m = at_m.min(0).values, at_m.max(0).values - at_m.min(0).values
        span_m = span_m.clamp(min=max(SMALLEST_SPAN * float(span_m.max()), LEAST_SPAN_M))
        numbers = {f"from_{axis}_m": low for axis, low in zip("xyz", low_m.tolist(), strict=True)}
        numbers |= {f"span_{axis}_m": span for axis, span in zip("xyz", span_m.tolist(), strict=True)}
        return ({key: float(f"{number:.6g}") for key, number in numbers.items()},)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover moved."""
        at_m = self._at_m(circumstances, place)
        return bool((at_m != at_m[0]).any())

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the readings determine; it is below the number of positions along each axis along which the mover moved."""
        at_m = self._at_m(circumstances, place)
        span_m = at_m.max(0).values - at_m.min(0).values
        moved = [i for i in range(3) if float(span_m[i]) > SMALLEST_SPAN * float(span_m.max())]
        n = min(len(torch.unique((at_m[:, i] / (SMALLEST_SPAN * span_m[i])).round())) for i in moved)
        bound = limit_of_number(self, len(at_m), "readings")
        if n > self.highest or bound.degree < n:
            return bound
        return Limit(n - 1, f"the mover was at {n} positions along one axis; measure at more")

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        ways = [
            (pose.translation_m[..., i] - theta[f"from_{axis}_m"].flatten()[0])
            / theta[f"span_{axis}_m"].flatten()[0]
            for i, axis in enumerate("xyz")
        ]
        shift = {axis: torch.zeros_like(ways[0]) for axis in "xyz"}
        for degree, amplitude in self.amplitudes(theta).items():
            waves = dict(zip("xyz", (torch.cos(math.pi * degree * way) for way in ways), strict=True))
            for i, term in enumerate(self.terms(degree)):
                axis, way = term[0], term[-1]
                shift[axis] = shift[axis] + amplitude[..., i, None] * waves[way]
        shift_m = torch.stack(torch.broadcast_tensors(*shift.values()), dim=-1)
        return Transform(pose.rotation, pose.translation_m + shift_m)

    @staticmethod
    def _at_m(circumstances: Circumstances, mover: str) -> Float[Tensor, "reading 3"]:
        """Reported positions of the mover."""
        motion = circumstances.observations.motion[mover]
        at_m: Tensor = base_from_motion(circumstances.rig.mover(mover), motion).translation_m
        return at_m
