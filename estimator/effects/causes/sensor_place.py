"""What a sensor says that depends on where the mover stands: a contact that works otherwise on one side of the way."""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.causes.sensor import AxisGain, SensorOffset
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import ReadingEffect
from estimator.tensors import Tensor, torch

CUTS = 6  # parts of the readings, between which a side may begin
PARTS = (AxisGain(), SensorOffset())  # of a contact, in the order in which they act
LEAST_WAY = 1e-3  # of the longest: along shorter ways there are no sides


class SensorContact(ReadingEffect):
    """The sensor has other gains and another zero where the mover stands beyond some place along one axis: a cable pulls at its contact.

    The mover is that of the sensor, or of the first coil that has one where the sensor stands still.
    """

    name: ClassVar[str] = "sensor_contact"
    words: ClassVar[str] = "on one side of the mover's way the sensor has other gains and another zero"
    source: ClassVar[str] = (
        "a worn cable or plug: per mille to per cents of a gain, and zeros as sensor_offset says"
    )

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Gains and zero beyond the place; the axis of the mover (0 x, 1 y, 2 z), the place along it, and the side (1 above, -1 below)."""
        ends_m = 100.0 * extent.reach_m
        return (
            *(quantity for part in PARTS for quantity in part.quantities(extent)),
            shape("along", "1", 0.0, 2.0, is_fixed=True),
            shape("beyond_m", "m", -ends_m, ends_m, is_fixed=True),
            shape("side", "1", -1.0, 1.0, is_fixed=True),
        )

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether a mover moved from one reading of the sensor to another."""
        at_m = _own_m(circumstances, place)
        return at_m is not None and bool((at_m != at_m[:1]).any())

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Either side of places that part the sensor's own readings evenly, along each axis along which the mover went between them."""
        at_m = _own_m(circumstances, place)
        assert at_m is not None  # see `concerns`
        way_m = at_m.max(0).values - at_m.min(0).values
        starts = []
        for axis in range(3):
            ordered_m = at_m[:, axis].sort().values
            if float(way_m[axis]) <= LEAST_WAY * float(way_m.max()):
                continue
            parts = ordered_m[torch.arange(1, CUTS, device=ordered_m.device) * len(ordered_m) // CUTS]
            places_m = ordered_m.unique()
            above = torch.searchsorted(places_m, parts).clamp(min=1).unique()
            for beyond_m in (0.5 * (places_m[above - 1] + places_m[above])).tolist():
                starts += [{"along": float(axis), "beyond_m": beyond_m, "side": side} for side in (1.0, -1.0)]
        return tuple(starts)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        at_m = circumstances.mover_of_sensor_m(sensor)
        if at_m is None:
            return field_sensor_T
        changed_T = field_sensor_T
        for part in PARTS:
            changed_T = part.apply(changed_T, theta, circumstances, sensor)
        along_m = at_m.T[theta["along"].long()]
        is_there = theta["side"][..., None] * (along_m - theta["beyond_m"][..., None]) > 0.0
        return torch.where(is_there[..., None], changed_T, field_sensor_T)


def _own_m(circumstances: Circumstances, sensor: str) -> Float[Tensor, "own 3"] | None:
    """Positions of the mover at the sensor's own readings, in m; None where nothing moves.

    With all of these on one side, a contact would be a gain and a zero.
    """
    at_m = circumstances.mover_of_sensor_m(sensor)
    return None if at_m is None else at_m[circumstances.is_of(sensor)]
