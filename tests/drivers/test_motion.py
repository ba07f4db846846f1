"""Poses on the way between two others, against scipy: the turn is about an axis of the start's own frame."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from drivers.protocols import FlangePose
from drivers.rotation import interpolate

START = FlangePose((0.1, -0.2, 0.3), (0.9, -0.4, 1.3))
TARGET = FlangePose((0.2, 0.2, 0.1), (-0.2, 0.7, 0.4))


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_a_pose_on_the_way_is_that_of_scipy(share):
    ends = Rotation.from_rotvec([START.rotation_vector_rad, TARGET.rotation_vector_rad])
    on_the_way = interpolate(START, TARGET, share)
    turn = Slerp([0.0, 1.0], ends)(share)
    np.testing.assert_allclose(on_the_way.rotation_vector_rad, turn.as_rotvec(), atol=1e-12)
    position_m = (1.0 - share) * np.array(START.position_m) + share * np.array(TARGET.position_m)
    np.testing.assert_allclose(on_the_way.position_m, position_m, atol=1e-15)
