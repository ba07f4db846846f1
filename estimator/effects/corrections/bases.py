"""Bases of corrections: what wanders, jumps or repeats, in time or along anything else, and what has a column for each degree."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import POSITIVE, WHEN, Quantities, Starts, Theta, box, fixed, shape, written
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import Composed, Scale, constant, constants
from estimator.effects.stages import Columns
from estimator.tensors import Tensor, torch

MOST_HALF_CYCLES = 320  # over the session or the range; sessions with fewer readings have fewer
COS_AND_SIN = ("cos", "sin")
SMALLEST_SPAN = 1e-3  # of the widest: along shorter ways nothing depends on the position
LEAST_SPAN_M = 1e-6
FROM, SPAN = (tuple(f"{end}_{axis}_m" for axis in "xyz") for end in ("from", "span"))

Variable = Float[Tensor, "*#batch #reading #component"]
Value = Float[Tensor, "*batch reading component"]

# From the first reading of the session on.
DURATION = Scale("duration_h", "h", lambda extent: 2.0 * extent.duration_h, lambda now, _: now.duration_h)


class Waves(Composed):
    """Cosines of half waves over a way from 0 to 1. Their amplitudes fall with the number, as of what wanders."""

    highest = 16
    falloff = 1.0

    def value(self, way: Variable, theta: Theta) -> Value:
        """Sum over the degrees of their waves times their amplitudes."""
        amplitudes = self.amplitudes(theta)
        if way.shape[-1] == 1:
            waves = torch.cos(math.pi * way * way.new_tensor([*amplitudes]))
            return waves @ torch.stack(list(amplitudes.values()), dim=-2)
        each = (a[..., None, :] * torch.cos(math.pi * degree * way) for degree, a in amplitudes.items())
        return sum(each, start=way.new_zeros(()))


class Periodic(Composed):
    """A cosine and a sine of each component, and of its overtones. A fit moves the frequency from where a start has put it."""

    highest = 3
    falloff = 1.0

    def terms(self, degree: int) -> tuple[str, ...]:
        """Cosine and sine of each component."""
        if len(self.components) == 1:
            return COS_AND_SIN
        return tuple(f"{component}_{wave}" for component in self.components for wave in COS_AND_SIN)

    def value(self, cycles: Variable, theta: Theta) -> Value:
        """Sum over the overtones, at so many cycles of the fundamental."""
        total = cycles.new_zeros(())
        for degree, amplitude in self.amplitudes(theta).items():
            cos, sin = amplitude.unflatten(-1, (-1, 2))[..., None, :, :].unbind(-1)
            phase = 2.0 * math.pi * degree * cycles
            total = total + cos * torch.cos(phase) + sin * torch.sin(phase)
        return total


class Table(Composed):
    """Each degree is a column of its own, in the order of likelihood."""

    def value(self, columns: Mapping[int, Variable], theta: Theta) -> Value:
        """Sum of the columns times their amplitudes; a degree without one is nothing."""
        each = (a[..., None, :] * columns[d] for d, a in self.amplitudes(theta).items() if d in columns)
        return sum(each, start=next(iter(theta.values())).new_zeros(1))


class AboveLevel(Composed):
    """One step at one level. It would be many half waves over the range, which swing where nothing was read."""

    highest = 1

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the sensor was read at several levels."""
        return len(self.starts(circumstances, place)) > 1

    def value(self, level_T: Variable, theta: Theta) -> Value:
        """The step, above the level."""
        return self.amplitudes(theta)[1][..., None, :] * (level_T > theta["above_T"][..., None, None])


def _own_times_s(circumstances: Circumstances, place: str) -> Tensor:
    """Times of the readings; for a sensor, only of its own."""
    time_s = circumstances.observations.time_s
    is_sensor = place in [sensor.name for sensor in circumstances.rig.sensors]
    return time_s[circumstances.is_of(place)] if is_sensor else time_s


class InTime(Composed):
    """A function of the time since the session began, in h; before 0, which stands for a moment without a session, there is nothing."""

    depends_on = WHEN
    counts = ("readings one after another", _own_times_s)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the session lasts longer than a moment."""
        return not circumstances.is_moment

    def columns(self, circumstances: Circumstances, mover: str) -> Columns:
        """Time since the session began, of a mover."""
        return circumstances.hours_for_instants[:, None]


class Wanders(InTime, Waves):
    """Half waves over the session."""

    scales: ClassVar[tuple[Scale, ...]] = (DURATION,)
    highest = 20

    def value(self, hours: Variable, theta: Theta) -> Value:
        """Sum of the waves at each time."""
        return super().value(hours / constant(theta, "duration_h"), theta) * (hours >= 0.0)


class Swings(InTime, Periodic):
    """It repeats in time. Periods shorter than two readings are seen at their aliases."""

    def shapes(self, extent: Extent) -> Quantities:
        """The frequency, up to half a cycle between readings."""
        spacing, n = extent.frequencies_per_h(MOST_HALF_CYCLES)
        return (shape("frequency_per_h", "1/h", 0.5 * spacing, (n + 0.5) * spacing),)

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """Frequencies half a cycle per session apart: between them a fifth of the power is lost at most."""
        return circumstances.frequencies(MOST_HALF_CYCLES)

    def value(self, hours: Variable, theta: Theta) -> Value:
        """Swing at each time."""
        return super().value(hours * theta["frequency_per_h"][..., None, None], theta) * (hours >= 0.0)


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

    def value(self, hours: Variable, theta: Theta) -> Value:
        """Sum of the steps so far."""
        total = hours.new_zeros(())
        for degree, step in self.amplitudes(theta).items():
            total = total + (hours >= theta[since(degree)][..., None, None]) * step[..., None, :]
        return total


def since(degree: int) -> str:
    """Key of the instant of a step."""
    return f"since{degree}_h"


class AlongWay(Composed):
    """Cosines of half waves over the way that a mover went along each axis: `x_along_y` is of component x along y."""

    @abstractmethod
    def at_m(self, circumstances: Circumstances, place: str) -> Float[Tensor, "reading 3"]:
        """Reported positions of the mover, in m."""

    def starts(self, circumstances: Circumstances, place: str) -> Starts:
        """The box that the mover went through, and scales."""
        at_m = self.at_m(circumstances, place)
        low_m, span_m = at_m.min(0).values, at_m.max(0).values - at_m.min(0).values
        span_m = span_m.clamp(min=max(SMALLEST_SPAN * float(span_m.max()), LEAST_SPAN_M))
        way = dict(zip((*FROM, *SPAN), (*low_m.tolist(), *span_m.tolist()), strict=True))
        return tuple(scales | written(way) for scales in super().starts(circumstances, place))

    def value(self, at_m: Float[Tensor, "*#batch reading 3"], theta: Theta) -> Value:
        """Sum of the waves along each axis."""
        way = (at_m - constants(theta, FROM)) / constants(theta, SPAN)
        cells = [f"{component}_along_{axis}" for axis in "xyz" for component in self.components]
        total = at_m.new_zeros(())
        for degree, amplitude in self.amplitudes(theta).items():
            place = torch.tensor([cells.index(term) for term in self.terms(degree)], device=at_m.device)
            in_cell = torch.nn.functional.one_hot(place, len(cells)).to(amplitude)
            by_way = (amplitude @ in_cell).unflatten(-1, (3, len(self.components)))
            total = total + torch.cos(math.pi * degree * way) @ by_way
        return total


def ends_of_ways(extent: Extent) -> tuple[Quantities, Quantities]:
    """Beginning and length of the way along each axis."""
    spans = tuple(fixed(key, "m", 0.0, 2.0 * extent.reach_m, POSITIVE) for key in SPAN)
    return box(FROM, "", "m", 100.0 * extent.reach_m, is_fixed=True), spans
