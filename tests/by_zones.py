"""The field of a winding at points at any distance, by the rules that predictions use there."""

from __future__ import annotations

import torch
from torch import Tensor

from estimator.field.winding import Winding, winding_field_per_ampere
from estimator.field.winding_shape import DEFAULT_TOLERANCE
from estimator.field.zones import zones_of


def winding_field(points_m: Tensor, winding: Winding, tolerance: float = DEFAULT_TOLERANCE) -> Tensor:
    field = torch.zeros_like(points_m)
    for zone in zones_of(winding, winding.distance_m(points_m), tolerance):
        field[zone.points] = winding_field_per_ampere(points_m[zone.points], winding, zone.rule)
    return field
