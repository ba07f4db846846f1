"""What a cause changes: the field that a calibration predicts, or only how readings of it came about."""

from __future__ import annotations

import pytest

from estimator.effects.use import is_in_field
from estimator.rig.rig import Cause


@pytest.mark.parametrize(
    ("name", "place", "expected"),
    [
        ("coil_misplaced", "coil1", True),
        ("mount_tilt", "coil1", True),
        ("sensor_misplaced", "hall", False),
        ("robot_scale", "arm1", True),
        ("coil_ovality", "coil1", True),
        ("axis_gain", "hall", False),
    ],
)
def test_where_a_coil_is_mounted_changes_its_field_and_where_a_sensor_is_does_not(
    small_rig, name, place, expected
):
    assert is_in_field(small_rig, Cause(name, place)) is expected
