"""In free space every field that an effect adds has neither divergence nor curl, but for the paper's literal sum, which is no field."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from estimator.effects import EFFECTS
from estimator.effects.stages import (
    CoreMagnetisation,
    RoomEffect,
    SourceEffect,
    WindingEffect,
    WindingMagnetisation,
)
from estimator.model.nominal import NominalPrediction
from tests.physics.effects.laboratory import POINTS_M, SOURCES, label_of, model_of, readings

UNIFORM = (
    "background_field",
    "background_drift",
    "background_step",
    "background_spell",
    "periodic_interference",
    "room_steps",
    "room_wanders",
)
FAR_M = 1.4 * POINTS_M  # an oval loop is summed over 32 nodes: its error dies out away from the wire


def added_gradient(name: str) -> Tensor:
    """d B_i / d x_j of what an effect adds, of both coils' currents."""
    observations = readings(FAR_M, (2.0, -3.0), time_s=1800.0 * torch.arange(len(FAR_M)).numpy())
    effects = {label_of(name): SOURCES[name]}
    with_it, without = (
        NominalPrediction(model_of(observations, e)).gradient_T_per_m("mapper") for e in (effects, {})
    )
    return with_it - without


def test_every_source_is_looked_at():
    kinds = (SourceEffect, RoomEffect, WindingEffect, WindingMagnetisation, CoreMagnetisation)
    assert set(SOURCES) == {name for name, effect in EFFECTS.items() if isinstance(effect, kinds)}


@pytest.mark.parametrize("name", [name for name in SOURCES if name not in ("spherical_sum", *UNIFORM)])
def test_added_field_has_neither_divergence_nor_curl(name):
    gradient = added_gradient(name)
    norm = gradient.flatten(1).norm(dim=1)
    assert (norm > 1e-9).all()
    tolerance = 1e-6 if name == "coil_ovality" else 1e-9
    assert (gradient.diagonal(dim1=1, dim2=2).sum(1).abs() < tolerance * norm).all()
    assert ((gradient - gradient.mT).flatten(1).norm(dim=1) < tolerance * norm).all()


@pytest.mark.parametrize("name", UNIFORM)
def test_field_of_the_room_has_no_gradient(name):
    assert added_gradient(name).abs().max() < 1e-15


def test_literal_sum_of_spherical_components_breaks_maxwells_equations():
    gradient = added_gradient("spherical_sum")
    norm = gradient.flatten(1).norm(dim=1)
    assert (gradient.diagonal(dim1=1, dim2=2).sum(1).abs() > 1e-2 * norm).any()
