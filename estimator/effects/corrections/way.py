"""What depends on where a mover stands: a basis of corrections."""

from __future__ import annotations

from abc import abstractmethod

from jaxtyping import Float

from estimator.effects.base import POSITIVE, Quantities, Starts, Theta, box, fixed, written
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import Correction
from estimator.tensors import Tensor, torch

SMALLEST_SPAN = 1e-3  # of the widest: along shorter ways nothing depends on the position
LEAST_SPAN_M = 1e-6
FROM, SPAN = (tuple(f"{end}_{axis}_m" for axis in "xyz") for end in ("from", "span"))


class AlongWay(Correction):
    """A function of the share of its way that a mover has gone along each axis."""

    @abstractmethod
    def at_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Reported positions of the mover, in m."""

    def ends(self, extent: Extent) -> tuple[Quantities, Quantities]:
        """Beginning and length of the way along each axis."""
        spans = tuple(fixed(key, "m", 0.0, 2.0 * extent.reach_m, POSITIVE) for key in SPAN)
        return box(FROM, "", "m", 100.0 * extent.reach_m, is_fixed=True), spans

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """The box that the mover went through, and scales."""
        at_m = self.at_m(circumstances, place)
        low_m, span_m = at_m.min(0).values, at_m.max(0).values - at_m.min(0).values
        span_m = span_m.clamp(min=max(SMALLEST_SPAN * float(span_m.max()), LEAST_SPAN_M))
        way = dict(zip((*FROM, *SPAN), (*low_m.tolist(), *span_m.tolist()), strict=True))
        return tuple(scales | written(way) for scales in super().starts(circumstances, place))

    def way(self, at_m: Float[Tensor, "*batch 3"], theta: Theta) -> Float[Tensor, "*batch 3"]:
        """Share of the way along each axis."""
        from_m, span_m = (torch.stack([theta[key].flatten()[0] for key in keys]) for keys in (FROM, SPAN))
        return (at_m - from_m) / span_m
