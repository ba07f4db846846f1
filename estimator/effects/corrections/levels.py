"""Corrections of what a sensor says above some level: missing codes of a converter, and an instrument that changes its range.

A step is many half waves over the range, which swing where nothing was read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import Quantity, Theta, shape, switch
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.corrections.correction import Correction, Limit, limit_of_number
from estimator.effects.stages import ReadingEffect
from estimator.tensors import Tensor, torch

MOST_LEVELS = 100  # of each axis
FEWEST_BEYOND = 3  # readings on either side of a level


class _AboveLevel(Correction, ReadingEffect):
    """One step at one level."""

    highest: ClassVar[int] = 1

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree that the number of different readings of the sensor determines."""
        shown_T = circumstances.observations.field_sensor_T[circumstances.is_of(place)]
        return limit_of_number(self, len(torch.unique(shown_T, dim=0)), "different readings")

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the sensor was read at several levels."""
        return len(self.starts(circumstances, place)) > 1


class AxisSteps(_AboveLevel):
    """One axis of a sensor reads more by a step wherever its component exceeds a level, as where codes are missing."""

    name: ClassVar[str] = "axis_steps"
    words: ClassVar[str] = "one axis of the sensor is off by a step above some level"

    def terms(self, degree: int) -> tuple[str, ...]:
        """Its only term: the step."""
        return ("step",)

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Number of the axis, and the level."""
        ends_T = 2.0 * extent.largest_field_T
        return (switch("axis", 0.0, 2.0, 0.0), shape("above_T", "T", -ends_T, ends_T, is_fixed=True))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Between any two readings of each axis."""
        shown_T = circumstances.observations.field_sensor_T[circumstances.is_of(place)]
        return tuple(
            {"axis": float(axis), "above_T": level_T}
            for axis in range(3)
            for level_T in _levels(shown_T[:, axis])
        )

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        is_axis = torch.arange(3, device=field_sensor_T.device) == theta["axis"][..., None, None]
        is_above = (field_sensor_T > theta["above_T"][..., None, None]) & is_axis
        return field_sensor_T + self.amplitudes(theta)[1][..., None, :] * is_above


class GainSteps(_AboveLevel):
    """The gain of a sensor is another one where its largest component exceeds a level, as where an instrument changes its range."""

    name: ClassVar[str] = "gain_steps"
    words: ClassVar[str] = "the gain of the sensor is another one above some level"
    unit: ClassVar[str] = "1"

    def terms(self, degree: int) -> tuple[str, ...]:
        """A share of all components."""
        return ("share",)

    def shapes(self, extent: Extent) -> tuple[Quantity, ...]:
        """Level above which the share holds, in T."""
        return (shape("above_T", "T", 0.0, 2.0 * extent.largest_field_T, is_fixed=True),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Level 0, under all readings, then levels between any two readings."""
        shown_T = circumstances.observations.field_sensor_T[circumstances.is_of(place)]
        return tuple({"above_T": level_T} for level_T in (0.0, *_levels(shown_T.abs().amax(-1))))

    def factors(
        self, circumstances: Circumstances, place: str, starts: Sequence[dict[str, float]]
    ) -> Float[Tensor, "start reading"]:
        """For each level 1 at readings above it, else 0."""
        shown_T = circumstances.observations.field_sensor_T.abs().amax(-1)
        levels_T = shown_T.new_tensor([start["above_T"] for start in starts])
        return (shown_T > levels_T[:, None]).to(circumstances.hours)

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        is_above = field_sensor_T.abs().amax(-1) > theta["above_T"][..., None]
        return field_sensor_T * (1.0 + (self.amplitudes(theta)[1] * is_above)[..., None])


def _levels(shown_T: Float[Tensor, " reading"]) -> list[float]:
    """Levels in the middle between two readings, with some readings on either side."""
    ordered_T = shown_T[~torch.isnan(shown_T)].unique()
    between_T = (0.5 * (ordered_T[1:] + ordered_T[:-1]))[FEWEST_BEYOND - 1 : 1 - FEWEST_BEYOND]
    if not len(between_T):
        return []
    rows = torch.linspace(0, len(between_T) - 1, min(MOST_LEVELS, len(between_T)), device=between_T.device)
    rows = rows.round().long().unique()
    levels_T: list[float] = between_T[rows].tolist()
    return levels_T
