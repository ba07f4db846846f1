"""Corrections that repeat: in time (a current, a sensor's zero), over the range of a converter, and along the guides of a mover."""

from __future__ import annotations

import math
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import (
    Correction,
    InTime,
    Limit,
    ShareOfCurrent,
    limit_of_number,
)
from estimator.effects.stages import MotionEffect, ReadingEffect
from estimator.frames import Transform
from estimator.geometry.motion import base_from_motion
from estimator.tensors import Tensor, torch

MOST_HALF_CYCLES = 320  # over the session or the range; sessions with fewer readings have fewer
SHORTEST_PERIOD_M = 0.5e-3  # finer pitches are rarer than errors that look like them


class _Periodic(Correction):
    """A cosine and a sine of each component, and of its overtones. A fit moves the frequency from where a start has put it."""

    highest: ClassVar[int] = 3
    falloff: ClassVar[float] = 1.0

    def terms(self, degree: int) -> tuple[str, ...]:
        """Cosine and sine of each component."""
        return tuple(f"{axis}_{wave}" for axis in "xyz" for wave in ("cos", "sin"))

    def _swinging(
        self, theta: Theta, cycles: Float[Tensor, "*#batch reading #component"]
    ) -> Float[Tensor, "*batch reading component"]:
        """Sum over the overtones, at so many cycles of the fundamental."""
        total = cycles.new_zeros(())
        for degree, amplitude in self.amplitudes(theta).items():
            cos, sin = amplitude.unflatten(-1, (-1, 2))[..., None, :, :].unbind(-1)
            phase = 2.0 * math.pi * degree * cycles
            total = total + cos * torch.cos(phase) + sin * torch.sin(phase)
        return total


class _Swing(InTime, _Periodic):
    """It repeats in time. Periods shorter than two readings are seen at their aliases."""

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The frequency, up to half a cycle between readings."""
        spacing, n = extent.frequencies_per_h(MOST_HALF_CYCLES)
        return (shape("frequency_per_h", "1/h", 0.5 * spacing, (n + 0.5) * spacing),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Frequencies half a cycle per session apart: between them a fifth of the power is lost at most."""
        spacing, n = circumstances.extent.frequencies_per_h(MOST_HALF_CYCLES)
        return tuple({"frequency_per_h": (i + 1) * spacing} for i in range(n))

    def _in_time(
        self, theta: Theta, circumstances: Circumstances
    ) -> Float[Tensor, "*batch reading component"]:
        """Swing at each reading; 0 where a single moment stands for a session, as in predictions."""
        if circumstances.is_moment:
            return circumstances.hours.new_zeros(len(circumstances), 1)
        return self._swinging(theta, (circumstances.hours * theta["frequency_per_h"][..., None])[..., None])


class CurrentSwings(ShareOfCurrent, _Swing):
    """The current of a coil swings, as of a regulator that hunts or of ripple that the readings' pace aliases."""

    name: ClassVar[str] = "current_swings"
    words: ClassVar[str] = "the coil's field per commanded ampere swings with a period"

    def terms(self, degree: int) -> tuple[str, ...]:
        """A share of the current."""
        return ("cos", "sin")

    def share(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*batch reading 1"]:
        """Share of the current at each reading: the sum of cosine and sine."""
        return self._in_time(theta, circumstances)


class ZeroSwings(_Swing, ReadingEffect):
    """The zero of a sensor swings, as of interference in its cable."""

    name: ClassVar[str] = "zero_swings"
    words: ClassVar[str] = "what the sensor shows in no field swings with a period"

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        return field_sensor_T + self._in_time(theta, circumstances)


class ReadingRipples(_Periodic, ReadingEffect):
    """Errors of a sensor's converter repeat over its range: each component is off by a wave of its own value."""

    name: ClassVar[str] = "reading_ripples"
    words: ClassVar[str] = "errors of the sensor repeat over its range"

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The frequency, in cycles per tesla."""
        spacing = _over_range(extent.largest_field_T)
        return (shape("frequency_per_T", "1/T", 0.0, 1e3 * MOST_HALF_CYCLES * spacing),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Frequencies half a cycle over the range apart, as many as there are readings at most."""
        spacing = _over_range(circumstances.largest_of_sensor_T(place))
        n = min(self._n_readings(circumstances, place), MOST_HALF_CYCLES)
        return tuple({"frequency_per_T": (i + 1) * spacing} for i in range(n))

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different readings of the sensor determines."""
        return limit_of_number(self, self._n_readings(circumstances, place), "different readings")

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        return field_sensor_T + self._swinging(
            theta, field_sensor_T * theta["frequency_per_T"][..., None, None]
        )

    @staticmethod
    def _n_readings(circumstances: Circumstances, place: str) -> int:
        is_own = circumstances.is_of(place)
        return len(torch.unique(circumstances.observations.field_sensor_T[is_own], dim=0))


class GuideSwings(_Periodic, MotionEffect):
    """Each axis of a mover runs fast and slow with one period along its way, as of a screw or a rack."""

    name: ClassVar[str] = "guide_swings"
    words: ClassVar[str] = "the mover errs with a period along its guides"
    unit: ClassVar[str] = "m"

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """The frequency, in cycles per metre."""
        return (shape("frequency_per_m", "1/m", 0.0, 1.0 / SHORTEST_PERIOD_M),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Frequencies half a cycle over the longest way apart, as many as there are readings at most."""
        spacing = 0.5 / max(_span_m(circumstances, place), SHORTEST_PERIOD_M)
        n = min(len(circumstances), MOST_HALF_CYCLES, int(1.0 / (SHORTEST_PERIOD_M * spacing)))
        return tuple({"frequency_per_m": (i + 1) * spacing} for i in range(max(1, n)))

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the mover moved farther than the shortest period."""
        return _span_m(circumstances, place) > SHORTEST_PERIOD_M

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of readings determines."""
        return limit_of_number(self, len(circumstances), "readings")

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        cycles = pose.translation_m * theta["frequency_per_m"][..., None, None]
        return Transform(pose.rotation, pose.translation_m + self._swinging(theta, cycles))


def _span_m(circumstances: Circumstances, mover: str) -> float:
    """The longest way of a mover along an axis."""
    motion = circumstances.observations.motion[mover]
    at_m = base_from_motion(circumstances.rig.mover(mover), motion).translation_m
    return float((at_m.max(0).values - at_m.min(0).values).max())


def _over_range(largest_T: float) -> float:
    """Frequency of half a cycle from minus to plus the largest component, in cycles per tesla."""
    return 0.25 / largest_T
