"""Corrections of what a sensor says: a smooth response in the components that it shows, curves of each axis and of the gain."""

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


class AxisCurves(Correction, ReadingEffect):
    """Each axis of a sensor has a curve of its own: cosines of half waves over its range, as of steps and bends of a converter."""

    name: ClassVar[str] = "axis_curves"
    words: ClassVar[str] = "each axis of the sensor errs as a function of what it shows"
    highest: ClassVar[int] = 16

    def terms(self, degree: int) -> tuple[str, ...]:
        """Components."""
        return ("x", "y", "z")

    def relative_width(self, degree: int) -> float:
        """One over the number of half waves, as of a curve with steps."""
        return 1.0 / degree

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Half of the range."""
        return (shape("range_T", "T", 0.0, 2.0 * extent.largest_field_T, is_fixed=True),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The largest component that the sensor read."""
        return ({"range_T": float(f"{circumstances.largest_of_sensor_T(place):.6g}")},)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """By the number of different readings of the sensor."""
        shown_T = circumstances.observations.field_sensor_T[_is_own(circumstances, place)]
        return limit_of_number(self, len(torch.unique(shown_T, dim=0)), "different readings")

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        way = 0.5 * (field_sensor_T / theta["range_T"].flatten()[0] + 1.0)
        for degree, amplitude in self.amplitudes(theta).items():
            field_sensor_T = field_sensor_T + amplitude[..., None, :] * torch.cos(math.pi * degree * way)
        return field_sensor_T


class GainCurve(Correction, ReadingEffect):
    """The gain of a sensor depends on the largest of its components, as where an instrument changes its range: cosines of half waves."""

    name: ClassVar[str] = "gain_curve"
    words: ClassVar[str] = "the gain of the sensor depends on how strong its largest component is"
    unit: ClassVar[str] = "1"
    highest: ClassVar[int] = 16

    def terms(self, degree: int) -> tuple[str, ...]:
        """A share of all components."""
        return ("share",)

    def relative_width(self, degree: int) -> float:
        """One over the number of half waves, as of a curve with steps."""
        return 1.0 / degree

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The strongest."""
        return (shape("range_T", "T", 0.0, 2.0 * extent.largest_field_T, is_fixed=True),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The largest component that the sensor read."""
        return ({"range_T": float(f"{circumstances.largest_of_sensor_T(place):.6g}")},)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """By the number of different readings of the sensor."""
        shown_T = circumstances.observations.field_sensor_T[_is_own(circumstances, place)]
        return limit_of_number(self, len(torch.unique(shown_T, dim=0)), "different readings")

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        way = field_sensor_T.abs().amax(-1) / theta["range_T"].flatten()[0]
        share = torch.zeros((), dtype=way.dtype)
        for degree, amplitude in self.amplitudes(theta).items():
            share = share + amplitude * torch.cos(math.pi * degree * way)
        return field_sensor_T * (1.0 + share[..., None])


def _is_own(circumstances: Circumstances, sensor: str) -> Tensor:
    return circumstances.sensor == [s.name for s in circumstances.rig.sensors].index(sensor)
