"""A coil that gives way reads as one that stands where the force takes it, with the force by magpylib."""

from __future__ import annotations

import magpylib
import numpy as np
import torch
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.model.room_field import RoomField
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import (
    POINTS_M,
    RIG,
    assert_same_field,
    effects_text,
    predicted_T,
    readings,
    winding,
)

COMPLIANCE = 5e-3  # m/N: these coils are small, and pull little
OTHER = Rotation.from_rotvec([0.0, -90.0, 0.0], degrees=True)
OTHER_M = np.array([0.12, 0.0, 0.0])


def force_on_coil_N(coil_A: float, other_A: float) -> np.ndarray:
    """Of mean loops with all turns, in the middle of each winding."""
    coil = magpylib.current.Circle(diameter=2 * 0.038, current=24 * coil_A, position=(0, 0, -3e-3))
    other = magpylib.current.Circle(
        diameter=2 * 0.0285,
        current=15 * other_A,
        position=OTHER_M + OTHER.apply([0, 0, -2.5e-3]),
        orientation=OTHER,
    )
    force_N, _ = magpylib.getFT(other, coil, meshing=500)
    return np.squeeze(force_N)


def both_T(shift_m: np.ndarray, coil_A: float, other_A: float) -> np.ndarray:
    """Of the coil where it was taken, and of the other where it stands."""
    in_other_m = OTHER.inv().apply(POINTS_M - OTHER_M)
    other_T = OTHER.apply(winding(0.03, 5, 3).field_T(in_other_m))
    return coil_A * winding().field_T(POINTS_M - shift_m) + other_A * other_T


def test_a_coil_goes_where_the_force_of_the_other_takes_it():
    for coil_A, other_A in ((200.0, -300.0), (200.0, 300.0)):
        shift_m = COMPLIANCE * force_on_coil_N(coil_A, other_A)
        assert 1e-5 < np.linalg.norm(shift_m) < 5e-3
        reading_T = predicted_T(
            readings(POINTS_M, (coil_A, other_A)), {"coil_pulled[coil]": {"compliance_m_per_N": COMPLIANCE}}
        )
        assert_same_field(reading_T, both_T(shift_m, coil_A, other_A), rtol=1e-5)


def test_alone_a_coil_feels_nothing_and_a_session_without_both_cannot_show_it():
    alone = readings(POINTS_M, (2.0, 0.0))
    effect = {"coil_pulled[coil]": {"compliance_m_per_N": COMPLIANCE}}
    assert_same_field(predicted_T(alone, effect), predicted_T(alone))
    rig = rig_from_text(RIG)
    pulled = EFFECTS["coil_pulled"]
    assert pulled.places(rig) == ("coil", "other")
    assert not pulled.concerns(Circumstances(rig, alone), "coil")
    assert pulled.concerns(Circumstances(rig, readings(POINTS_M, (2.0, -1.0))), "coil")


def test_a_prediction_has_the_coil_where_the_currents_of_the_moment_take_it():
    """For many currents at once, and with currents of its own at each point."""
    effects = {"coil_pulled[coil]": {"compliance_m_per_N": COMPLIANCE}}
    rig = rig_from_text(RIG + effects_text(effects))
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in rig.nominal_values().items()}
    room = RoomField(rig, values, torch.from_numpy(POINTS_M), tolerance=1e-12)
    currents_A = torch.tensor([[200.0, -300.0], [200.0, 300.0], [200.0, 0.0]], dtype=torch.float64)
    together_T = room.field_T(values, currents_A).numpy()
    for field_T, (coil_A, other_A) in zip(together_T, currents_A.tolist(), strict=True):
        shift_m = COMPLIANCE * force_on_coil_N(coil_A, other_A) if other_A else np.zeros(3)
        assert_same_field(field_T, both_T(shift_m, coil_A, other_A), rtol=1e-5)
    by_point_A = currents_A[torch.arange(len(POINTS_M)) % 3]
    by_point_T = room.field_by_point_T(values, by_point_A).numpy()
    for i, field_T in enumerate(by_point_T):
        assert_same_field(field_T[None], together_T[i % 3, i][None], rtol=1e-12)
