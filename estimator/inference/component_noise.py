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
from estimator.rig.coordinates import Values


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

    def sigma_T(self, sigma_T: Tensor, values: Values) -> Tensor:
        """Standard deviation of every component with this effect, given that without it."""
        changed_T = self.use.effect.sigma_T(sigma_T, self.exposure, self.use.theta(values))
        return self._where_concerned(changed_T, sigma_T)

    def contamination(self, share: Tensor, ratio: Tensor, values: Values) -> tuple[Tensor, Tensor]:
        """Share of wider scatter in every component, and how many times wider it is, given those without this effect."""
        contamination = self._contamination(values)
        if contamination is None:
            return share, ratio
        return self._where_concerned(contamination[0], share), self._where_concerned(contamination[1], ratio)

    def mixed(
        self, log_density: Tensor, weight: Tensor, whitened: Tensor, values: Values
    ) -> tuple[Tensor, Tensor]:
        """Log density of every whitened residual without its constant, and its weight, given those without this effect."""
        contamination = self._contamination(values)
        if contamination is None:
            return log_density, weight
        share, ratio = contamination
        good = torch.log1p(-share) + log_density
        bad = torch.log(share) - torch.log(ratio) - 0.5 * (whitened / ratio) ** 2
        both = torch.logaddexp(good, bad)
        is_good = torch.exp(good - both)
        reduced = is_good + (1.0 - is_good) / ratio**2
        return self._where_concerned(both, log_density), self._where_concerned(reduced, weight)

    def _contamination(self, values: Values) -> tuple[Tensor, Tensor] | None:
        contamination = self.use.effect.contamination(self.use.theta(values))
        return None if contamination is None else (contamination[0][..., None], contamination[1][..., None])

    def _where_concerned(
        self, changed: Float[Tensor, "*#batch #component"], unchanged: Float[Tensor, "*#batch component"]
    ) -> Float[Tensor, "*batch component"]:
        """Changed numbers of the components that it concerns, unchanged ones of all others."""
        return changed if self.concerned is None else torch.where(self.concerned, changed, unchanged)
