"""Targets of corrections: what of the measurement is corrected by a function, of the time unless a declaration says otherwise."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from jaxtyping import Float

from estimator.effects.base import Theta
from estimator.effects.circumstances import Circumstances
from estimator.effects.corrections.correction import RANGE_A, RANGE_T, Composed, constant
from estimator.effects.stages import (
    Columns,
    Components,
    Current,
    MotionEffect,
    OneCoilCurrent,
    ReadingEffect,
    RoomEffect,
)
from estimator.frames import Transform
from estimator.tensors import Tensor, torch


class CurrentShare(Composed, OneCoilCurrent):
    """A share of the current of a coil, or of the field that an ampere makes; of the largest current where that is a scale."""

    unit = "1"
    components = ("share",)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried current, and what the basis asks."""
        return super().concerns(circumstances, place) and circumstances.has_current(place)

    def variable(self, current_A: Current, theta: Theta, circumstances: Circumstances, coil: int) -> Any:
        """What the share is a function of."""
        return circumstances.hours_for_instants[:, None]

    def delivered(self, current_A: Current, theta: Theta, circumstances: Circumstances, coil: int) -> Current:
        """Current in the coil, in A."""
        share = self.value(self.variable(current_A, theta, circumstances, coil), theta)[..., 0]
        return current_A + share * (constant(theta, "range_A") if RANGE_A in self.scales else current_A)


class Room(Composed, RoomEffect):
    """The field of the room, everywhere alike."""

    def drifting_T(self, theta: Theta, circumstances: Circumstances) -> Components:
        """Field in the world frame, in T."""
        return self.value(circumstances.hours_for_instants[:, None], theta)


class Place(Composed, MotionEffect):
    """Place of a mover."""

    unit = "m"

    def variable(self, pose: Transform, columns: Columns, theta: Theta) -> Any:
        """What the place is a function of."""
        return columns

    def apply(self, pose: Transform, columns: Columns, theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        shift_m = self.value(self.variable(pose, columns, theta), theta)
        return Transform(pose.rotation, pose.translation_m + shift_m)


class Shown(Composed, ReadingEffect):
    """Something of what a sensor says."""

    def variable(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Any:
        """What it is a function of."""
        return circumstances.hours_for_instants[:, None]

    @abstractmethod
    def added_T(self, field_sensor_T: Components, value: Tensor, theta: Theta) -> Components:
        """What is added to the components, given the value of the function."""

    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """Components as they are read."""
        value = self.value(self.variable(field_sensor_T, theta, circumstances, sensor), theta)
        return field_sensor_T + self.added_T(field_sensor_T, value, theta)


class Zero(Shown):
    """What a sensor shows in no field."""

    def added_T(self, field_sensor_T: Components, value: Tensor, theta: Theta) -> Components:
        """The value itself."""
        return value


class Gain(Shown):
    """The gain of all axes of a sensor."""

    unit = "1"
    components = ("share",)

    def added_T(self, field_sensor_T: Components, value: Tensor, theta: Theta) -> Components:
        """A share of all components."""
        return field_sensor_T * value


class ZeroAndGain(Shown):
    """What a sensor shows in no field, and the gain of each axis in units of its range."""

    components = tuple(f"{kind}{axis}" for kind in ("", "gain_") for axis in "xyz")
    scales = (RANGE_T,)

    def added_T(self, field_sensor_T: Components, value: Tensor, theta: Theta) -> Components:
        """The first three components, and shares of the field by the others."""
        zero_T, gain_T = value[..., :3], value[..., 3:]
        return zero_T + field_sensor_T / constant(theta, "range_T") * gain_T


class Response(Shown):
    """Gains and axes of a sensor: the first of two components changes by a share of the second."""

    components = tuple(f"{axis}_{other}" for axis in "xyz" for other in "xyz")

    def added_T(self, field_sensor_T: Components, value: Tensor, theta: Theta) -> Components:
        """The value as a matrix, by the components; in units of the sensor's range where that is a scale."""
        matrix = value.unflatten(-1, (3, 3))
        if RANGE_T in self.scales:
            matrix = matrix / constant(theta, "range_T")
        return (matrix @ field_sensor_T[..., None])[..., 0]


class Turned(Shown):
    """How a sensor is turned in its own frame, to first order in the turn."""

    unit = "1"

    def added_T(
        self, field_sensor_T: Components, value: Float[Tensor, "*#batch #reading 3"], theta: Theta
    ) -> Components:
        """Change of the components along turned axes."""
        field_sensor_T, turn_rad = torch.broadcast_tensors(field_sensor_T, value)
        return torch.linalg.cross(field_sensor_T, turn_rad, dim=-1)
