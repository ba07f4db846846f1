"""Corrections by steps: what holds from an instant on, of a current, a sensor's zero, where a mover stands, and the field of the room.

A jump is many half waves, and readings near it stay wrong. A few steps at instants that a diagnosis looks for are a jump, or contacts that
open and close.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import InTime, ShareOfCurrent
from estimator.effects.stages import MotionEffect, ReadingEffect, RoomEffect
from estimator.frames import Transform
from estimator.tensors import Tensor, torch


class _Steps(InTime):
    """Each degree is one more step, which stays from its instant on."""

    def terms(self, degree: int) -> tuple[str, ...]:
        """Components of what jumps."""
        return ("x", "y", "z")

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The instant of each step, in time since the session began."""
        degrees = range(self.lowest, min(extent.degree, self.highest) + 1)
        return tuple(shape(since(d), "h", 0.0, extent.duration_h, is_fixed=True) for d in degrees)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The beginning, then each instant between two readings, for the first step."""
        return tuple({since(1): instant_h} for instant_h in _instants_h(circumstances))

    def factors(
        self, circumstances: Circumstances, place: str, starts: Sequence[dict[str, float]]
    ) -> Float[Tensor, "start reading"]:
        """Readings from each instant on."""
        instants_h = circumstances.hours.new_tensor([start[since(1)] for start in starts])
        return circumstances.is_since(instants_h).to(instants_h)

    def _stepped(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*batch reading term"]:
        """Sum of the steps so far; zero where a single moment stands for a session, as in predictions."""
        amplitudes = self.amplitudes(theta)
        if circumstances.is_moment:
            amplitudes = {degree: torch.zeros_like(step) for degree, step in amplitudes.items()}
        total = circumstances.hours.new_zeros(())
        for degree, step in amplitudes.items():
            total = total + circumstances.is_since(theta[since(degree)])[..., None] * step[..., None, :]
        return total


class CurrentSteps(ShareOfCurrent, _Steps):
    """The current of a coil, or how much field an ampere makes, jumps: contacts, a core, a supply that was set anew."""

    name: ClassVar[str] = "current_steps"
    single: ClassVar[str] = "current_step"
    words: ClassVar[str] = "the coil's field per commanded ampere jumps"
    highest: ClassVar[int] = 12

    def share(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*batch reading 1"]:
        """Share of the current at each reading: the sum of the steps so far."""
        return self._stepped(theta, circumstances)


class ZeroSteps(_Steps, ReadingEffect):
    """What a sensor shows in no field jumps."""

    name: ClassVar[str] = "zero_steps"
    single: ClassVar[str] = "offset_step"
    words: ClassVar[str] = "what the sensor shows in no field jumps"
    highest: ClassVar[int] = 5

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        return field_sensor_T + self._stepped(theta, circumstances)


class ResponseSteps(_Steps, ReadingEffect):
    """The response of a sensor jumps, or that of iron beside it, which answers much the same field: it was exchanged, turned or moved."""

    name: ClassVar[str] = "response_steps"
    words: ClassVar[str] = "gains and axes of the sensor, or of iron beside it, jump"
    unit: ClassVar[str] = "1"
    highest: ClassVar[int] = 2

    def terms(self, degree: int) -> tuple[str, ...]:
        """Pairs of components: the first changes by a share of the second."""
        return tuple(f"{axis}_{other}" for axis in "xyz" for other in "xyz")

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        matrix = self._stepped(theta, circumstances).unflatten(-1, (3, 3))
        added_T: Tensor = (matrix @ field_sensor_T[..., None])[..., 0]
        return field_sensor_T + added_T


class GuidesStep(_Steps, MotionEffect):
    """The mover's real position jumps: a slipped clamp, a lost step, a knock."""

    name: ClassVar[str] = "guides_step"
    single: ClassVar[str] = "mover_slipped"
    words: ClassVar[str] = "where the mover stands jumps"
    unit: ClassVar[str] = "m"
    highest: ClassVar[int] = 4

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """Time since the session began."""
        return circumstances.hours_for_instants[:, None]

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        shift_m = columns.new_zeros(())
        for degree, step_m in self.amplitudes(theta).items():
            is_since = columns[:, 0] >= theta[since(degree)][..., None]
            shift_m = shift_m + is_since[..., None] * step_m[..., None, :]
        return Transform(pose.rotation, pose.translation_m + shift_m)


class RoomSteps(_Steps, RoomEffect):
    """The field of the room jumps, everywhere alike: something is brought near, or taken away."""

    name: ClassVar[str] = "room_steps"
    single: ClassVar[str] = "background_step"
    words: ClassVar[str] = "the field of the room jumps"
    highest: ClassVar[int] = 5

    def drifting_T(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*#batch reading 3"]:
        """Field of the room in the world frame that its steps add, in T."""
        return self._stepped(theta, circumstances)


def since(degree: int) -> str:
    """Key of the instant of a step."""
    return f"since{degree}_h"


def _instants_h(circumstances: Circumstances) -> list[float]:
    """The beginning, and the middle between any two times at which there are readings."""
    times_h = circumstances.hours.unique()
    return [0.0, *(0.5 * (times_h[1:] + times_h[:-1])).tolist()]
