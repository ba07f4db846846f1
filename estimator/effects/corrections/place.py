"""A correction of what a sensor says that depends on where the mover stands: a cable that pulls, a contact that works on one side only."""

from __future__ import annotations

import math
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, limit_of_number
from estimator.effects.stages import ReadingEffect
from estimator.tensors import Tensor, torch

SMALLEST_SPAN = 1e-3  # of the widest: along shorter ways nothing depends on the position
LEAST_SPAN_M = 1e-6


class ResponseByPlace(Correction, ReadingEffect):
    """Zero and gain of each axis follow cosines of half waves over the way that the mover went along each of its axes.

    The mover is that of the sensor, or of the first coil that has one where the sensor stands still.
    """

    name: ClassVar[str] = "response_by_place"
    words: ClassVar[str] = "zero and gains of the sensor depend on where the mover stands"
    highest: ClassVar[int] = 8
    falloff: ClassVar[float] = 1.0

    def terms(self, degree: int) -> tuple[str, ...]:
        """Zero (`x_along_y`) and gain (`gain_x_along_y`) of which axis, along which way."""
        return tuple(f"{kind}{axis}_along_{way}" for kind in ("", "gain_") for way in "xyz" for axis in "xyz")

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The field in units of which gains are told, where the way along each axis begins, and how long it is."""
        ends_m = 100.0 * extent.reach_m
        return (
            shape("range_T", "T", 0.0, 2.0 * extent.largest_field_T, is_fixed=True),
            *(shape(f"from_{axis}_m", "m", -ends_m, ends_m, is_fixed=True) for axis in "xyz"),
            *(shape(f"span_{axis}_m", "m", 0.0, 2.0 * extent.reach_m, is_fixed=True) for axis in "xyz"),
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The largest component that the sensor read, and the box that the mover went through."""
        at_m = _at_m(circumstances, place)
        low_m, span_m = at_m.min(0).values, at_m.max(0).values - at_m.min(0).values
        span_m = span_m.clamp(min=max(SMALLEST_SPAN * float(span_m.max()), LEAST_SPAN_M))
        numbers = {"range_T": circumstances.largest_of_sensor_T(place)}
        numbers |= {f"from_{axis}_m": low for axis, low in zip("xyz", low_m.tolist(), strict=True)}
        numbers |= {f"span_{axis}_m": span for axis, span in zip("xyz", span_m.tolist(), strict=True)}
        return ({key: float(f"{number:.6g}") for key, number in numbers.items()},)

    def broken_rule(self, values: dict[str, float]) -> tuple[str, str] | None:  # type: ignore[override]
        """Units and ways are positive."""
        lengths = ("range_T", *(f"span_{axis}_m" for axis in "xyz"))
        return next(((key, "must be > 0") for key in lengths if values[key] <= 0.0), None)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether a mover moved from one reading of the sensor to another."""
        if circumstances.mover_of_sensor_m(place) is None:
            return False
        own_m = _at_m(circumstances, place)[circumstances.is_of(place)]
        return bool((own_m != own_m[:1]).any())

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different positions of the mover at the sensor's own readings determines."""
        own_m = _at_m(circumstances, place)[circumstances.is_of(place)]
        n_places = len(torch.unique((1e6 * own_m).round(), dim=0))
        return limit_of_number(self, n_places, "different places")

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        from_m, span_m = (
            torch.stack([theta[f"{key}_{axis}_m"].flatten()[0] for axis in "xyz"]) for key in ("from", "span")
        )
        way = (_at_m(circumstances, sensor) - from_m) / span_m
        share = field_sensor_T / theta["range_T"].flatten()[0]
        for degree, amplitude in self.amplitudes(theta).items():
            zero, gain = amplitude.unflatten(-1, (2, 3, 3)).unbind(-3)  # way, axis
            waves = torch.cos(math.pi * degree * way)
            field_sensor_T = field_sensor_T + waves @ zero + share * (waves @ gain)
        return field_sensor_T


def _at_m(circumstances: Circumstances, sensor: str) -> Float[Tensor, "reading 3"]:
    """Reported positions of the mover of the sensor, or else of the first coil that has one, in m."""
    at_m = circumstances.mover_of_sensor_m(sensor)
    assert at_m is not None  # see `concerns`
    return at_m
