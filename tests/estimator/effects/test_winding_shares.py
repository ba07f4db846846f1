"""Relative changes of a winding leave a winding: no radius, wire or number of loops becomes nothing or negative."""

from __future__ import annotations

import math

import pytest
import torch

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent


@pytest.mark.parametrize("name", ["winding_misstated", "sides_misstated", "axial_pitch", "radial_pitch"])
def test_nothing_is_left_of_no_number(name):
    for quantity in EFFECTS[name].quantities(Extent()):
        nothing, half = (quantity.prior.log_density(torch.tensor(change)) for change in (-1.0, -0.5))
        assert float(nothing) == -math.inf
        assert math.isfinite(float(half))
