"""Corrections that are smooth functions of time: of a sensor's zero and response, the room's field, a current, and where a mover stands."""

from __future__ import annotations

import math
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import InTime, ShareOfCurrent
from estimator.effects.corrections.turning import shown_by_turned
from estimator.effects.stages import MotionEffect, ReadingEffect, RoomEffect
from estimator.frames import Transform
from estimator.tensors import Tensor, torch


class _Drift(InTime):
    """Cosines of half waves over the session. Their amplitudes fall with the number, as of what wanders."""

    highest: ClassVar[int] = 20
    falloff: ClassVar[float] = 1.0

    def terms(self, degree: int) -> tuple[str, ...]:
        """Components of what wanders."""
        return ("x", "y", "z")

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Duration of the session, from its first reading on."""
        return (shape("duration_h", "h", 0.0, 2.0 * extent.duration_h, is_fixed=True),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Duration of this session, in h."""
        return ({"duration_h": float(f"{circumstances.duration_h:.6g}")},)

    @staticmethod
    def _wave(theta: Theta, circumstances: Circumstances, degree: int) -> Float[Tensor, " reading"]:
        """Half wave of a degree at each reading, a pure number; 0 where a single moment stands for a session, as in predictions."""
        if circumstances.is_moment:
            return torch.zeros_like(circumstances.hours)
        return torch.cos(math.pi * degree * circumstances.hours / theta["duration_h"].flatten()[0])

    def _wandering(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*batch reading term"]:
        """Sum over the degrees of their waves times their amplitudes."""
        amplitudes = self.amplitudes(theta)
        waves = torch.stack([self._wave(theta, circumstances, degree) for degree in amplitudes], dim=-1)
        total: Tensor = waves @ torch.stack(list(amplitudes.values()), dim=-2)
        return total


class ZeroWanders(_Drift, ReadingEffect):
    """The zero of a sensor wanders smoothly."""

    name: ClassVar[str] = "zero_wanders"
    words: ClassVar[str] = "what the sensor shows in no field wanders with time"

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        return field_sensor_T + self._wandering(theta, circumstances)


class RoomWanders(_Drift, RoomEffect):
    """The field of the room wanders smoothly, everywhere alike."""

    name: ClassVar[str] = "room_wanders"
    words: ClassVar[str] = "the field of the room wanders with time"

    def drifting_T(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*#batch reading 3"]:
        """Wandering field of the room in the world frame, in T."""
        return self._wandering(theta, circumstances)


class ResponseWanders(_Drift, ReadingEffect):
    """The response of a sensor wanders smoothly: its gains, its axes or how it is turned."""

    name: ClassVar[str] = "response_wanders"
    words: ClassVar[str] = "gains and axes of the sensor, or how it is turned, wander with time"
    highest: ClassVar[int] = 6

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Duration of the session, and the field in units of which components are taken."""
        range_T = shape("range_T", "T", 0.0, 2.0 * extent.largest_field_T, is_fixed=True)
        return (*super().shapes(extent), range_T)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Duration of this session, in h, and the largest component that the sensor read, in T."""
        range_T = float(f"{circumstances.largest_of_sensor_T(place):.6g}")
        return tuple({**start, "range_T": range_T} for start in super().starts(circumstances, place))

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
        parts = field_sensor_T / theta["range_T"].flatten()[0]
        matrix = self._wandering(theta, circumstances).unflatten(-1, (3, 3))
        added_T: Tensor = (matrix @ parts[..., None])[..., 0]
        return field_sensor_T + added_T


class TurnsWander(_Drift, ReadingEffect):
    """A sensor is turned, by an angle that wanders: it creeps in its clamp. Degree 0 is a turn that stays."""

    name: ClassVar[str] = "turns_wander"
    words: ClassVar[str] = "the sensor turns with time"
    unit: ClassVar[str] = "1"
    lowest: ClassVar[int] = 0
    highest: ClassVar[int] = 8

    def relative_width(self, degree: int) -> float:
        """Width of the amplitudes of a degree over that of the first; degree 0 has that of the first."""
        return super().relative_width(max(degree, 1))

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read, to first order in the turn."""
        return shown_by_turned(field_sensor_T, self._wandering(theta, circumstances))


class CurrentWanders(ShareOfCurrent, _Drift):
    """The current of a coil, or how much field an ampere makes, wanders: it warms up, sags, jumps or loosens."""

    name: ClassVar[str] = "current_wanders"
    words: ClassVar[str] = "the coil's field per commanded ampere wanders with time"
    highest: ClassVar[int] = 40

    def share(self, theta: Theta, circumstances: Circumstances) -> Float[Tensor, "*batch reading 1"]:
        """Share of the current at each reading: the sum of all half waves."""
        return self._wandering(theta, circumstances)


class GuidesWander(_Drift, MotionEffect):
    """The mover's real position wanders: it warms up, creeps, or its clock runs apart from the sensor's."""

    name: ClassVar[str] = "guides_wander"
    words: ClassVar[str] = "where the mover stands wanders with time"
    unit: ClassVar[str] = "m"
    highest: ClassVar[int] = 12

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """Waves of every degree."""
        duration_h = circumstances.hours.new_tensor(circumstances.duration_h)
        degrees = range(self.lowest, self.highest + 1)
        waves = [self._wave({"duration_h": duration_h}, circumstances, degree) for degree in degrees]
        return torch.stack(waves, dim=-1)

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose, or real displacement."""
        amplitudes = self.amplitudes(theta)
        waves = columns[:, [degree - self.lowest for degree in amplitudes]]
        shift_m = waves @ torch.stack(list(amplitudes.values()), dim=-2)
        return Transform(pose.rotation, pose.translation_m + shift_m)
