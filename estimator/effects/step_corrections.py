"""Corrections by steps: what holds from an instant on, of a current, a sensor's zero, where a mover stands, and the field of the room.

A jump is many half waves, and readings near it stay wrong. A few steps at instants that a diagnosis looks for are a jump, or contacts that
open and close.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch
from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.correction import InTime, Limit, limit_of_places, positions_m
from estimator.effects.harmonic_corrections import RoomAnswers, RoomHarmonics
from estimator.effects.stages import MotionEffect, OneCoilCurrent, ReadingEffect
from estimator.frames import Transform


class _Steps(InTime):
    """Each degree is one more step, which stays from its instant on."""

    is_stepwise: ClassVar[bool] = True

    def terms(self, degree: int) -> tuple[str, ...]:
        """Components."""
        return ("x", "y", "z")

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The instant of each step, in time since the session began."""
        degrees = range(self.lowest, extent.degree + 1)
        return tuple(shape(since(d), "h", 0.0, extent.duration_h, is_fixed=True) for d in degrees)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The beginning, then each instant between two readings, for the first step."""
        return tuple({since(1): instant_h} for instant_h in _instants_h(circumstances))

    def factors(
        self, circumstances: Circumstances, place: str, starts: Sequence[dict[str, float]]
    ) -> Float[Tensor, "start reading"]:
        """Readings from each instant on."""
        instants_h = torch.tensor([start[since(1)] for start in starts], dtype=torch.float64)
        return circumstances.is_since(instants_h).double()

    def _stepped(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*batch reading term"]:
        """Sum of the steps so far; zero where a single moment stands for a session, as in predictions."""
        amplitudes = self.amplitudes(theta)
        if circumstances.is_moment:
            amplitudes = {degree: torch.zeros_like(step) for degree, step in amplitudes.items()}
        total = torch.zeros((), dtype=torch.float64)
        for degree, step in amplitudes.items():
            total = total + circumstances.is_since(theta[since(degree)])[..., None] * step[..., None, :]
        return total


class CurrentSteps(_Steps, OneCoilCurrent):
    """The current of a coil, or how much field an ampere makes, jumps: contacts, a core, a supply that was set anew."""

    name: ClassVar[str] = "current_steps"
    words: ClassVar[str] = "the coil's field per commanded ampere jumps"
    unit: ClassVar[str] = "1"
    highest: ClassVar[int] = 12

    def terms(self, degree: int) -> tuple[str, ...]:
        """A share of the current."""
        return ("share",)

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        return current_A * (1.0 + self._stepped(theta, circumstances)[..., 0])


class ZeroSteps(_Steps, ReadingEffect):
    """What a sensor shows in no field jumps."""

    name: ClassVar[str] = "zero_steps"
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


class GuidesStep(_Steps, MotionEffect):
    """Where a mover stands jumps: a slipped clamp, a lost step, a knock."""

    name: ClassVar[str] = "guides_step"
    words: ClassVar[str] = "where the mover stands jumps"
    unit: ClassVar[str] = "m"
    highest: ClassVar[int] = 4

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """Time since the session began."""
        hours = torch.full_like(circumstances.hours, -1.0) if circumstances.is_moment else circumstances.hours
        return hours[:, None]

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        shift_m = torch.zeros((), dtype=torch.float64)
        for degree, step_m in self.amplitudes(theta).items():
            is_since = columns[:, 0] >= theta[since(degree)][..., None]
            shift_m = shift_m + is_since[..., None] * step_m[..., None, :]
        return Transform(pose.rotation, pose.translation_m + shift_m)


class _Since(InTime):
    """A smooth field that is there from one instant on."""

    highest: ClassVar[int] = 3

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The ball of reference, and the instant."""
        return (*super().shapes(extent), shape("since_h", "h", 0.0, extent.duration_h, is_fixed=True))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """The beginning, then each instant between two readings."""
        [ball] = super().starts(circumstances, place)
        return tuple({**ball, "since_h": instant_h} for instant_h in _instants_h(circumstances))

    def factors(
        self, circumstances: Circumstances, place: str, starts: Sequence[dict[str, float]]
    ) -> Float[Tensor, "start reading"]:
        """Readings from each instant on."""
        instants_h = torch.tensor([start["since_h"] for start in starts], dtype=torch.float64)
        return circumstances.is_since(instants_h).double()

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """By the places; there must have been time."""
        return limit_of_places(positions_m(circumstances), self.n_terms)  # type: ignore[attr-defined]

    def presence(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*batch reading"]:
        """Whether it is there at a reading; in predictions it never is."""
        if circumstances.is_moment:
            return torch.zeros(len(circumstances), dtype=torch.float64)
        return circumstances.is_since(theta["since_h"]).double()


class RoomChanges(_Since, RoomHarmonics):
    """Something is brought into the room, or taken away."""

    name: ClassVar[str] = "room_changes"
    words: ClassVar[str] = "a smooth field that stays in the room comes or goes at one instant"
    is_background: ClassVar[bool] = False


class RoomAnswersChange(_Since, RoomAnswers):
    """Something that answers a coil is brought into the room, or moved: iron, a cable."""

    name: ClassVar[str] = "room_answers_change"
    words: ClassVar[str] = (
        "a smooth field that stays in the room and goes with the coil's current comes or goes at one instant"
    )

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Where the coil carried current and was moved, in a session that lasts."""
        return InTime.concerns(self, circumstances, place) and RoomAnswers.concerns(self, circumstances, place)


def since(degree: int) -> str:
    """Key of the instant of a step."""
    return f"since{degree}_h"


def _instants_h(circumstances: Circumstances) -> list[float]:
    """The beginning, and the middle between any two times at which there are readings."""
    times_h = circumstances.hours.unique()
    return [0.0, *(0.5 * (times_h[1:] + times_h[:-1])).tolist()]
