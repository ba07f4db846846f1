"""Corrections that are functions of time: what wanders, swings or jumps (a basis), and what of the measurement does so (a target).

A kind is a target and a basis together.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import WHEN, Quantities, Starts, Theta, fixed, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import RANGE_T, Correction, Limit, Scale, limit_of_number
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

MOST_HALF_CYCLES = 320  # over the session or the range; sessions with fewer readings have fewer
COS_AND_SIN = ("cos", "sin")


# From the first reading of the session on.
DURATION = Scale("duration_h", "h", lambda extent: 2.0 * extent.duration_h, lambda now, _: now.duration_h)


class InTime(Correction):
    """A function of the time in one session."""

    depends_on = WHEN

    @abstractmethod
    def value(
        self, hours: Float[Tensor, " reading"], theta: Theta
    ) -> Float[Tensor, "*batch reading component"]:
        """Each component at times since the session began, in h; 0 before, which stands for a moment without a session."""

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the session lasts longer than a moment."""
        return not circumstances.is_moment

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different times determines; for a sensor, only its own readings count."""
        time_s = circumstances.observations.time_s
        if place in [sensor.name for sensor in circumstances.rig.sensors]:
            time_s = time_s[circumstances.is_of(place)]
        return limit_of_number(self, len(torch.unique(time_s)), "readings one after another")


class Waves(InTime):
    """Cosines of half waves over the session. Their amplitudes fall with the number, as of what wanders."""

    scales: ClassVar[tuple[Scale, ...]] = (DURATION,)
    highest = 20
    falloff = 1.0

    def value(
        self, hours: Float[Tensor, " reading"], theta: Theta
    ) -> Float[Tensor, "*batch reading component"]:
        """Sum over the degrees of their waves times their amplitudes."""
        amplitudes = self.amplitudes(theta)
        share = hours / theta["duration_h"].flatten()[0]
        waves = torch.stack([torch.cos(math.pi * degree * share) for degree in amplitudes], dim=-1)
        waves = waves * (hours >= 0.0)[:, None]
        total: Tensor = waves @ torch.stack(list(amplitudes.values()), dim=-2)
        return total


class Steps(InTime):
    """Each degree is one more step, which stays from its instant on.

    A jump is many half waves, and readings near it stay wrong. A few steps at instants that a diagnosis looks for are a jump, or contacts
    that open and close.
    """

    def shapes(self, extent: Extent) -> Quantities:
        """The instant of each step, in time since the session began."""
        degrees = range(self.lowest, min(extent.degree, self.highest) + 1)
        return tuple(fixed(since(d), "h", 0.0, extent.duration_h) for d in degrees)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """The beginning, then each instant between two readings, for the first step."""
        times_h = circumstances.hours.unique()
        return tuple({since(1): at_h} for at_h in (0.0, *(0.5 * (times_h[1:] + times_h[:-1])).tolist()))

    def factors(
        self, circumstances: Circumstances, place: str, starts: Sequence[dict[str, float]]
    ) -> Float[Tensor, "start reading"]:
        """Readings from each instant on."""
        instants_h = circumstances.hours.new_tensor([start[since(1)] for start in starts])
        return circumstances.is_since(instants_h).to(instants_h)

    def value(
        self, hours: Float[Tensor, " reading"], theta: Theta
    ) -> Float[Tensor, "*batch reading component"]:
        """Sum of the steps so far."""
        total = hours.new_zeros(())
        for degree, step in self.amplitudes(theta).items():
            is_since = hours >= theta[since(degree)][..., None]
            total = total + is_since[..., None] * step[..., None, :]
        return total


def since(degree: int) -> str:
    """Key of the instant of a step."""
    return f"since{degree}_h"


class Periodic(Correction):
    """A cosine and a sine of each component, and of its overtones. A fit moves the frequency from where a start has put it."""

    highest = 3
    falloff = 1.0

    def terms(self, degree: int) -> tuple[str, ...]:
        """Cosine and sine of each component."""
        if len(self.components) == 1:
            return COS_AND_SIN
        return tuple(f"{component}_{wave}" for component in self.components for wave in COS_AND_SIN)

    def swing(
        self, theta: Theta, cycles: Float[Tensor, "*#batch reading #component"]
    ) -> Float[Tensor, "*batch reading component"]:
        """Sum over the overtones, at so many cycles of the fundamental."""
        total = cycles.new_zeros(())
        for degree, amplitude in self.amplitudes(theta).items():
            cos, sin = amplitude.unflatten(-1, (-1, 2))[..., None, :, :].unbind(-1)
            phase = 2.0 * math.pi * degree * cycles
            total = total + cos * torch.cos(phase) + sin * torch.sin(phase)
        return total


class Swings(InTime, Periodic):
    """It repeats in time. Periods shorter than two readings are seen at their aliases."""

    def shapes(self, extent: Extent) -> Quantities:
        """The frequency, up to half a cycle between readings."""
        spacing, n = extent.frequencies_per_h(MOST_HALF_CYCLES)
        return (shape("frequency_per_h", "1/h", 0.5 * spacing, (n + 0.5) * spacing),)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """Frequencies half a cycle per session apart: between them a fifth of the power is lost at most."""
        return circumstances.frequencies(MOST_HALF_CYCLES)

    def value(
        self, hours: Float[Tensor, " reading"], theta: Theta
    ) -> Float[Tensor, "*batch reading component"]:
        """Swing at each time."""
        total: Tensor = self.swing(theta, (hours * theta["frequency_per_h"][..., None])[..., None])
        return total * (hours >= 0.0)[:, None]


class CurrentShare(InTime, OneCoilCurrent):
    """A share of the current of a coil, or of the field that an ampere makes."""

    unit = "1"
    components = ("share",)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the session lasts longer than a moment, and the coil carried current."""
        return super().concerns(circumstances, place) and circumstances.has_current(place)

    def delivered(self, current_A: Current, theta: Theta, circumstances: Circumstances, coil: int) -> Current:
        """Current in the coil, in A."""
        return current_A * (1.0 + self.value(circumstances.hours_for_instants, theta)[..., 0])


class Room(InTime, RoomEffect):
    """The field of the room, everywhere alike."""

    def drifting_T(self, theta: Theta, circumstances: Circumstances) -> Components:
        """Field in the world frame, in T."""
        return self.value(circumstances.hours_for_instants, theta)


class Guides(InTime, MotionEffect):
    """Place of a mover."""

    unit = "m"

    def columns(self, circumstances: Circumstances, mover: str) -> Columns:
        """Time since the session began."""
        return circumstances.hours_for_instants[:, None]

    def apply(self, pose: Transform, columns: Columns, theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        return Transform(pose.rotation, pose.translation_m + self.value(columns[:, 0], theta))


class Zero(InTime, ReadingEffect):
    """What a sensor shows in no field."""

    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """Components as they are read."""
        return field_sensor_T + self.value(circumstances.hours_for_instants, theta)


class Response(InTime, ReadingEffect):
    """Gains and axes of a sensor: the first of two components changes by a share of the second."""

    components = tuple(f"{axis}_{other}" for axis in "xyz" for other in "xyz")

    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
        """Components as they are read."""
        matrix = self.value(circumstances.hours_for_instants, theta).unflatten(-1, (3, 3))
        if RANGE_T in self.scales:
            matrix = matrix / theta["range_T"].flatten()[0]
        added_T: Tensor = (matrix @ field_sensor_T[..., None])[..., 0]
        return field_sensor_T + added_T
