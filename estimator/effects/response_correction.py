"""A correction of what a sensor says: a smooth response in the components that it shows."""

from __future__ import annotations

import math
from itertools import combinations_with_replacement
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.correction import Correction, Limit, limit_of_number
from estimator.effects.stages import ReadingEffect


class SensorResponse(Correction, ReadingEffect):
    """Each component that the sensor shows bends with all three."""

    name: ClassVar[str] = "sensor_response"
    words: ClassVar[str] = "a smooth response of the sensor in the three components that it shows"
    lowest: ClassVar[int] = 0
    highest: ClassVar[int] = 3

    def terms(self, degree: int) -> tuple[str, ...]:
        """For each component, the products of components: `x_yy` adds the square of y to x; `x` alone a constant."""
        products = ["".join(axes) for axes in combinations_with_replacement("xyz", degree)]
        return tuple(f"{axis}_{product}".rstrip("_") for axis in "xyz" for product in products)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """By the number of different readings of the sensor."""
        shown_T = circumstances.observations.field_sensor_T[_is_own(circumstances, place)]
        return limit_of_number(self, len(torch.unique(shown_T, dim=0)), "different readings")

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The field in units of which the products are taken."""
        return (shape("range_T", "T", 0.0, 2.0 * extent.largest_field_T, is_fixed=True),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The largest component that the sensor read."""
        return ({"range_T": float(f"{circumstances.largest_of_sensor_T(place):.6g}")},)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        x, y, z = (field_sensor_T / theta["range_T"].flatten()[0]).unbind(-1)
        parts = {"x": x, "y": y, "z": z}
        for degree, amplitude in self.amplitudes(theta).items():
            products = [
                math.prod((parts[axis] for axis in axes), start=torch.ones_like(x))
                for axes in combinations_with_replacement("xyz", degree)
            ]
            by_component = amplitude.unflatten(-1, (3, len(products)))
            field_sensor_T = field_sensor_T + torch.stack(products, dim=-1) @ by_component.mT
        return field_sensor_T


def _is_own(circumstances: Circumstances, sensor: str) -> Tensor:
    return circumstances.sensor == [s.name for s in circumstances.rig.sensors].index(sensor)
