"""Where a mover must bring its flange, by hand and with scipy's rotations; and back from there to the readings."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from estimator.frames import Transform
from estimator.geometry.motion import flange_to_reach, motion_reached
from estimator.rig.bodies import DisplacementFrame, MotionKind, Mover

AT_ZERO_M, TURN_AT_ZERO = np.array([0.3, -0.1, 0.4]), Rotation.from_rotvec([0.9, -0.4, 1.3])
MOVED_M, TURN = np.array([0.02, 0.05, -0.03]), Rotation.from_rotvec([0.2, -0.1, 0.3])
OWN_AXES = Mover("stage", MotionKind.DISPLACEMENT)
BASE_AXES = Mover(
    "stage", MotionKind.DISPLACEMENT, DisplacementFrame.BASE, tuple(TURN_AT_ZERO.as_rotvec().tolist())
)
POSE = Mover("stage", MotionKind.POSE)

REACHED = {
    "displaced along its own axes": (OWN_AXES, AT_ZERO_M + TURN_AT_ZERO.apply(MOVED_M), TURN_AT_ZERO * TURN),
    "displaced along the axes of its base": (BASE_AXES, AT_ZERO_M + MOVED_M, TURN * TURN_AT_ZERO),
    "given as a pose": (POSE, MOVED_M, TURN),
}


@pytest.mark.parametrize(("mover", "position_m", "turn"), REACHED.values(), ids=REACHED)
def test_a_flange_is_brought_to_where_its_readings_say(mover, position_m, turn):
    """The reference is turned, so that the order of the axes shows: first the reference pose, then the move in its axes."""
    reference = Transform.from_pose(torch.from_numpy(AT_ZERO_M), torch.from_numpy(TURN_AT_ZERO.as_rotvec()))
    motion = torch.from_numpy(np.concatenate((MOVED_M, TURN.as_rotvec())))[None]
    reached = flange_to_reach(mover, motion, reference)
    np.testing.assert_allclose(reached.translation_m[0], position_m, atol=1e-14)
    np.testing.assert_allclose(reached.rotation[0], turn.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(motion_reached(mover, reached, reference, motion), motion, atol=1e-13)
