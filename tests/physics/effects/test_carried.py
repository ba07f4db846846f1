"""A magnet that a coil carries along, against magpylib's dipole."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.rig_files.read import rig_from_text
from tests.physics.effects.laboratory import POINTS_M, RIG, added_T, assert_same_field, dipole_T, readings

MOMENT_A_M2, AT_M = np.array([0.2, -0.1, 0.3]), np.array([0.03, 0.02, -0.09])
LINK = {
    "magnetised_link[coil]": {
        **dict(zip(("moment_x_A_m2", "moment_y_A_m2", "moment_z_A_m2"), MOMENT_A_M2, strict=True)),
        **dict(zip(("x_m", "y_m", "z_m"), AT_M, strict=True)),
    }
}


def test_link_is_a_dipole_whatever_the_current_and_without_any():
    current_A = np.stack((np.array([2.0, 0.0, -3.0, 0.0, 1.0, 0.0, 0.0]), np.zeros(len(POINTS_M))), axis=1)
    expected = dipole_T(MOMENT_A_M2, AT_M, POINTS_M)
    assert_same_field(added_T(readings(POINTS_M, current_A), LINK), expected, 1e-6)
    assert_same_field(added_T(readings(POINTS_M, (0.0, 0.0)), LINK), expected)


CARRIED = (
    RIG.replace(
        "  coil: {radius_mm", "  coil: {carried_by: arm, world_from_coil0: {z_mm: -60, rx_deg: 10}, radius_mm"
    )
    .replace("{mapper: {motion: pose}}", "{arm: {motion: displacement}}")
    .replace("carried_by: mapper, ", "")
)


def test_link_moves_and_turns_with_its_coil():
    turn = Rotation.from_rotvec([10.0, 0.0, 0.0], degrees=True)
    steps_m = np.array([[0.0, 0.0, 0.0], [0.02, 0.01, -0.01], [-0.03, 0.015, 0.01]])
    coil_m = np.array([0.0, 0.0, -0.06]) + turn.apply(steps_m)
    expected = turn.apply(dipole_T(MOMENT_A_M2, AT_M, turn.inv().apply(-coil_m)))
    assert_same_field(added_T(readings(steps_m, (0.0, 0.0), mover="arm"), LINK, CARRIED), expected)


def test_a_coil_that_stands_still_carries_nothing_along():
    """A diagnosis would name it for a field of the room beside a piece of iron."""
    for text, mover, is_asked in ((RIG, "mapper", False), (CARRIED, "arm", True)):
        rig = rig_from_text(text)
        circumstances = Circumstances(rig, readings(POINTS_M, (1.0, 0.0), mover=mover))
        assert EFFECTS["magnetised_link"].concerns(circumstances, "coil") is is_asked
