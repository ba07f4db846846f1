"""How a year is counted: by name, by name and place, and by needless updates; every version is made current again."""

from __future__ import annotations

from typing import Any

import pytest

from scripts.studies import recalibrate_years as years


def year(cause: str, *named: str, updates: tuple[int, ...] = ()) -> dict[str, Any]:
    weeks = [
        {"conclusion": "updated" if i in (1, *updates) else "unchanged", "named": []} for i in range(1, 20)
    ]
    return {"cause": cause, "weeks": [*weeks, {"conclusion": "drifted", "named": [list(named)]}]}


@pytest.mark.parametrize(
    ("cause", "named", "is_right", "is_strict"),
    [
        ("sensor_misplaced[turned]", ("sensor_misplaced[hall]", "sensor_misplaced[turned]"), True, True),
        ("sensor_misplaced[turned]", ("sensor_misplaced[hall]",), True, False),
        ("mount_tilt[coil1]", ("mount_tilt",), True, True),
        ("robot_scale", ("axis_gain[hall]",), False, False),
    ],
)
def test_a_cause_at_another_sensor_is_not_strictly_right(cause, named, is_right, is_strict):
    row = year(cause, *named)
    assert (years.is_right(row), years.is_strict(row)) == (is_right, is_strict)


def test_needless_updates_are_counted_but_not_the_first_calibration():
    assert years.needless(year("robot_scale", "robot_scale", updates=(8, 12))) == [8, 12]
    assert years.needless(year("robot_scale", "robot_scale")) == []
    assert not years.alarms(year("robot_scale", "robot_scale", updates=(8,)))
