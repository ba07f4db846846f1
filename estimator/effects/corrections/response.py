"""Corrections of what a sensor says: a smooth response in what it shows, curves of axes and gain, and what it shows of currents."""

from __future__ import annotations

import math
from itertools import combinations_with_replacement
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import LEAST_STEP, Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, limit_of_number
from estimator.effects.stages import ReadingEffect
from estimator.tensors import Tensor, torch


class _OverRange(Correction, ReadingEffect):
    """A function of what the sensor shows, in units of its largest component."""

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Unit of the response: the largest component that the sensor read, in T."""
        return (shape("range_T", "T", 0.0, 2.0 * extent.largest_field_T, is_fixed=True),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The largest component that the sensor read."""
        return ({"range_T": float(f"{circumstances.largest_of_sensor_T(place):.6g}")},)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different readings of the sensor determines."""
        shown_T = circumstances.observations.field_sensor_T[circumstances.is_of(place)]
        return limit_of_number(self, len(torch.unique(shown_T, dim=0)), "different readings")


class SensorResponse(_OverRange):
    """Each component that the sensor shows bends with all three."""

    name: ClassVar[str] = "sensor_response"
    words: ClassVar[str] = "a smooth response of the sensor in the three components that it shows"
    lowest: ClassVar[int] = 0
    asked_from: ClassVar[int] = 1  # a constant is `sensor_offset`
    highest: ClassVar[int] = 3

    def terms(self, degree: int) -> tuple[str, ...]:
        """For each component, the products of components: `x_yy` adds the square of y to x; `x` alone a constant."""
        products = ["".join(axes) for axes in combinations_with_replacement("xyz", degree)]
        return tuple(f"{axis}_{product}".rstrip("_") for axis in "xyz" for product in products)

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


class AxisCurves(_OverRange):
    """Each axis of a sensor has a curve of its own: cosines of half waves over its range, as of steps and bends of a converter."""

    name: ClassVar[str] = "axis_curves"
    words: ClassVar[str] = "each axis of the sensor errs as a function of what it shows"
    highest: ClassVar[int] = 16
    falloff: ClassVar[float] = 1.0

    def terms(self, degree: int) -> tuple[str, ...]:
        """Components, each with a curve of its own."""
        return ("x", "y", "z")

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


class GainCurve(_OverRange):
    """The gain of a sensor depends on the largest of its components, as where an instrument changes its range: cosines of half waves."""

    name: ClassVar[str] = "gain_curve"
    words: ClassVar[str] = "the gain of the sensor depends on how strong its largest component is"
    unit: ClassVar[str] = "1"
    highest: ClassVar[int] = 16
    falloff: ClassVar[float] = 1.0

    def terms(self, degree: int) -> tuple[str, ...]:
        """A share of all components."""
        return ("share",)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        way = field_sensor_T.abs().amax(-1) / theta["range_T"].flatten()[0]
        share = way.new_zeros(())
        for degree, amplitude in self.amplitudes(theta).items():
            share = share + amplitude * torch.cos(math.pi * degree * way)
        return field_sensor_T * (1.0 + share[..., None])


class CurrentPickup(Correction, ReadingEffect):
    """A sensor shows something of the coils' currents themselves, as over a common return wire: powers of their sum."""

    name: ClassVar[str] = "current_pickup"
    words: ClassVar[str] = "the sensor shows something of the currents themselves"
    highest: ClassVar[int] = 3

    def terms(self, degree: int) -> tuple[str, ...]:
        """Components that show something of the currents."""
        return ("x", "y", "z")

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The current in units of which powers are taken."""
        return (shape("range_A", "A", 0.0, 100.0 * extent.largest_current_A, is_fixed=True),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Largest current of the session, in A."""
        return ({"range_A": float(f"{circumstances.largest_current_A:.6g}")},)

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different currents besides 0 determines, of those while the sensor was read."""
        total_A = circumstances.current_A[circumstances.is_of(place)].sum(-1)
        n = len(
            torch.unique((total_A[total_A != 0.0] / (LEAST_STEP * circumstances.largest_current_A)).round())
        )
        if n >= self.highest:
            return Limit(self.highest)
        return Limit(n, f"there are {n} currents besides 0; measure at {self.highest} or more")

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        share = circumstances.current_A.sum(-1) / theta["range_A"].flatten()[0]
        for degree, amplitude in self.amplitudes(theta).items():
            field_sensor_T = field_sensor_T + amplitude[..., None, :] * share[:, None] ** degree
        return field_sensor_T
