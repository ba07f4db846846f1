"""How readings scatter beyond equal normal noise. The model predicts the same; the likelihood is another."""

from __future__ import annotations

from typing import ClassVar

from estimator.effects.base import Kind, NoiseEffect, Quantity
from estimator.effects.circumstances import Circumstances, Extent
from estimator.rig.parameters import LogNormal, Uniform


class Outliers(NoiseEffect):
    """A share of the readings is wrong: a contaminated normal distribution with a wide second component."""

    name: ClassVar[str] = "outliers"
    kind: ClassVar[Kind] = Kind.SENSOR
    words: ClassVar[str] = "a share of the readings is wrong"
    source: ClassVar[str] = "dropped bits, late triggers: some per mille to 10 %"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Share of wrong components and their scatter in units of the noise."""
        return (
            Quantity("share", "1", Uniform(0.0, 0.5), 0.0, is_fixed=True),
            Quantity("ratio", "1", Uniform(1.0, 1e4), 1.0, is_shape=True, is_fixed=True),
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Ten times the noise."""
        return ({"ratio": 10.0},)


class PositionJitter(NoiseEffect):
    """The mover scatters about its target; the field's gradient turns that into scatter of the reading."""

    name: ClassVar[str] = "position_jitter"
    kind: ClassVar[Kind] = Kind.MOVER
    words: ClassVar[str] = "the mover scatters about its targets"
    source: ClassVar[str] = "repeatability of small arms, 10 to 100 um"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Standard deviation of the position along each axis."""
        return (Quantity("sd_m", "m", LogNormal(50e-6, 1.0), 0.0),)
