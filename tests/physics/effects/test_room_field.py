"""The field that a rig with effects has in the room is what an upright sensor without faults of its own reads there."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from estimator.model.room_field import RoomField
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import (
    POINTS_M,
    RIG,
    SOURCES,
    assert_same_field,
    effects_text,
    label_of,
    predicted_T,
    readings,
)

CURRENT_A = (2.0, -3.0)
CASES = {
    **{
        label_of(name): given
        for name, given in SOURCES.items()
        if name
        not in (
            "background_drift",
            "periodic_interference",
            "room_steps",
            "room_wanders",
        )  # these need a clock
    },
    "current_gain[coil]": {"excess": 0.03},
    "current_offset[other]": {"offset_A": 0.07},
    "current_sign[coil]": {"sign": -1.0},
    "neighbour_coil[coil]": {"share": 0.05},
}


def room_field_T(effects: dict[str, dict[str, float]]) -> np.ndarray:
    rig = rig_from_text(RIG + effects_text(effects))
    values = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
    field = RoomField(rig, values, torch.from_numpy(POINTS_M), tolerance=1e-13)
    return field.field_T(values, torch.tensor(CURRENT_A, dtype=torch.float64)).numpy()


@pytest.mark.parametrize("label", CASES)
def test_field_of_the_room_is_what_the_model_predicts(label):
    effects = {label: CASES[label]}
    room_T = room_field_T(effects)
    assert_same_field(room_T, predicted_T(readings(POINTS_M, CURRENT_A), effects), 1e-9)
    assert (np.abs(room_T - room_field_T({})) > 0.0).any()
