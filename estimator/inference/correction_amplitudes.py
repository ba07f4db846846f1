"""Amplitudes of corrections: coordinates that predictions are linear in, so that a difference gives their derivative.

A correction may have hundreds. One evaluation moves many of them at once, each in a row of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.effects.corrections.correction import KEY, Correction
from estimator.effects.stages import ReadingEffect, RoomEffect, SourceEffect
from estimator.effects.use import Use, uses_of
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig

AMPLITUDE_STEP = 1e-3  # of the prior's width: predictions are nearly linear in amplitudes
COMPONENTS_AT_ONCE = 2**20  # entries of one array of predictions; calculations keep a few dozen such arrays


@dataclass(frozen=True)
class CorrectionAmplitudes:
    """The coordinates that are amplitudes of corrections.

    Attributes:
        of_fields: Numbers of those that correct the field.
        of_readings: Numbers of those that correct what is read of it.
    """

    of_fields: Int[Tensor, " of_fields"]
    of_readings: Int[Tensor, " of_readings"]

    @classmethod
    def of(cls, rig: Rig, coordinates: Coordinates) -> CorrectionAmplitudes:
        """Amplitudes of a rig's corrections among its coordinates."""
        of_fields = _numbers([*uses_of(rig, SourceEffect), *uses_of(rig, RoomEffect)], coordinates)
        return cls(of_fields, _numbers(uses_of(rig, ReadingEffect), coordinates))

    @property
    def each(self) -> Int[Tensor, " column"]:
        """Numbers of all amplitudes."""
        return torch.cat((self.of_fields, self.of_readings))

    def jacobian_T(
        self,
        coordinates: Coordinates,
        model: MeasurementModel,
        measured: Callable[[Tensor], Tensor],
        vector: Float[Tensor, "*batch coordinate"],
        columns: Int[Tensor, " column"],
    ) -> Float[Tensor, "*batch component column"]:
        """Derivatives of the predictions in some amplitudes.

        Args:
            coordinates: Those of the rig.
            model: Predicts the readings.
            measured: Takes the measured components of anything given by reading and axis.
            vector: One row of coordinates.
            columns: Numbers of the amplitudes.
        """
        step = AMPLITUDE_STEP * coordinates.scale[columns]
        with torch.no_grad():
            values = coordinates.values(vector.flatten())
            at_sensor_T = model.at_sensor_T(values)
            middle_T = measured(model.shown_T(values, at_sensor_T)).flatten()
            jacobian_T = vector.new_empty(len(middle_T), len(columns))
            for is_field in (True, False):
                mine = (torch.isin(columns, self.of_fields) == is_field).nonzero().flatten()
                for part in mine.split(max(1, COMPONENTS_AT_ONCE // max(1, len(middle_T)))):
                    each = torch.diag(step[part])
                    names = [coordinates.names[i] for i in columns[part].tolist()]
                    there = {**values, **{n: values[n] + each[:, i] for i, n in enumerate(names)}}
                    field_T = model.at_sensor_T(there) if is_field else at_sensor_T
                    changed_T = measured(model.shown_T(there, field_T))
                    jacobian_T[:, part] = ((changed_T - middle_T) / step[part, None]).T
        return jacobian_T.expand(*vector.shape[:-1], -1, -1)


def _numbers(uses: Sequence[Use[Any]], coordinates: Coordinates) -> Int[Tensor, " column"]:
    """Numbers of the coordinates that are amplitudes of some effects."""
    names = coordinates.names[: coordinates.n_continuous]
    rows = [
        i
        for use in uses
        if isinstance(use.effect, Correction)
        for i, name in enumerate(names)
        if name.startswith(f"{use.label}.") and KEY.fullmatch(name.removeprefix(f"{use.label}."))
    ]
    return torch.tensor(rows, dtype=torch.int64, device=coordinates.device)
