"""What a model predicts at the nominal values of its rig, and how readings change where a mover is displaced."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from jaxtyping import Float

from estimator.derivatives import jacobian_of
from estimator.effects.stages import Prediction
from estimator.field.node_sum import SumMode
from estimator.frames import Transform
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import Values
from estimator.tensors import Tensor


@dataclass(frozen=True)
class NominalPrediction(Prediction):
    """Predictions of a model at the nominal values of its rig.

    Attributes:
        model: Of the readings.
    """

    model: MeasurementModel

    @cached_property
    def field_sensor_T(self) -> Float[Tensor, "reading 3"]:
        """Components as they should be read."""
        field_T = self.model.predict(self.model.nominal)
        return field_T.expand(len(self.model.circumstances), 3)

    def gradient_T_per_m(self, mover: str) -> Float[Tensor, "reading 3 3"]:
        """Change of each component per displacement of a mover along its axes."""
        return gradient_T_per_m(self.model, self.model.nominal, mover)


def gradient_T_per_m(model: MeasurementModel, values: Values, mover: str) -> Float[Tensor, "reading 3 3"]:
    """Change of each component that a model predicts per displacement of a mover along its axes, at some values (no batch)."""
    model = model.with_mode(SumMode.FIRST_ORDER)
    sources = model.sources
    poses = sources.flange[mover]

    def moved(shift_m: Tensor) -> Tensor:
        displaced = Transform(poses.rotation, poses.translation_m + shift_m)
        there = replace(sources, flange={**sources.flange, mover: displaced})
        return replace(model, sources=there).predict(values).expand(len(model.circumstances), 3)

    return jacobian_of(moved, poses.translation_m.new_zeros(3))
