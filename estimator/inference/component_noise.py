"""An effect of noise, as the measured components of some readings have it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from estimator.effects.stages import NoiseEffect
from estimator.effects.use import Use
from estimator.model.measurement_model import MeasurementModel
from estimator.model.nominal import NominalPrediction


@dataclass(frozen=True)
class ComponentNoise:
    """An effect of noise in the measured components.

    Attributes:
        use: The effect and the place that has it.
        concerned: Components that it concerns; None stands for all.
        exposure: What their scatter depends on besides the effect's quantities.
    """

    use: Use[NoiseEffect]
    concerned: Bool[Tensor, " component"] | None
    exposure: Float[Tensor, " component"]

    @classmethod
    def of(
        cls, use: Use[NoiseEffect], model: MeasurementModel, measured: Callable[[Tensor], Tensor]
    ) -> ComponentNoise:
        """An effect of noise in the readings of a model.

        Args:
            use: The effect and its place.
            model: Predicts the readings.
            measured: Takes the measured components of anything given by reading and axis.
        """
        readings = use.concerned(model.circumstances)
        concerned = None if readings is None else measured(readings[:, None].expand(-1, 3))
        return cls(use, concerned, measured(use.effect.exposure(NominalPrediction(model), use.place)))

    def part(self, components: Int[Tensor, " part"]) -> ComponentNoise:
        """This noise in some of the components.

        Args:
            components: Their numbers.
        """
        concerned = None if self.concerned is None else self.concerned[components]
        return ComponentNoise(self.use, concerned, self.exposure[components])

    def where_concerned(
        self, changed: Float[Tensor, "*#batch #component"], unchanged: Float[Tensor, "*#batch component"]
    ) -> Float[Tensor, "*batch component"]:
        """Changed numbers of the components that it concerns, unchanged ones of all others."""
        return changed if self.concerned is None else torch.where(self.concerned, changed, unchanged)
