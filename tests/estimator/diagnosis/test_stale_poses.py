"""Poses that are those of the row before: told where each n-th row has one, and not where several sensors stand at one place."""

from __future__ import annotations

from dataclasses import replace

import torch

from estimator.diagnosis.stale_poses import stale_poses
from estimator.readings.observations import Observations
from estimator.rig_files.read import rig_from_text
from tests.estimator.diagnosis.small_fits import fit_of

EVERY = 5


def _as_at_next(readings: Observations, rows: torch.Tensor) -> Observations:
    """Readings of which some rows show what the next reading of the same sensor does."""
    field_T = readings.field_sensor_T.clone()
    for row in rows.tolist():
        later = (readings.sensor[row + 1 :] == readings.sensor[row]).nonzero().flatten()
        if len(later):
            field_T[row] = readings.field_sensor_T[row + 1 + later[0]]
    return readings.with_field(field_T)


def test_each_fifth_row_with_the_pose_before_is_found(small_session):
    readings = small_session.observations.calibration
    fit = fit_of(small_session.rig, readings)
    motion = readings.motion["arm1"].clone()
    stale = torch.arange(EVERY, len(readings), EVERY)
    motion[stale] = readings.motion["arm1"][stale - 1]
    (flag,) = stale_poses(fit, _as_at_next(replace(readings, motion={"arm1": motion}), stale))
    assert set(flag.readings) <= set(stale.tolist())
    assert len(flag.readings) > 0.7 * len(stale)


def test_rows_that_fit_neither_the_pose_before_nor_that_after_are_not_said_to(small_session):
    both = small_session.observations.alone
    readings = replace(both, is_validation=torch.zeros_like(both.is_validation))
    fit = fit_of(small_session.rig, readings)
    motion = readings.motion["arm1"].clone()
    stale = torch.arange(1, len(readings), 4)  # of which three are nearer to what follows, by chance
    motion[stale] = readings.motion["arm1"][stale - 1]
    assert stale_poses(fit, replace(readings, motion={"arm1": motion})) == []


def test_the_last_of_three_sensors_at_each_place_has_no_stale_pose(small_session, rig_text):
    rig = rig_from_text(rig_text + "  second: {noise_uT: 5}\n  third: {noise_uT: 5}\n")
    at_places = small_session.observations.calibration.alone
    n = len(at_places)
    readings = replace(
        at_places.rows(torch.arange(n).repeat_interleave(3)).alone,
        sensor=torch.arange(3).repeat(n),
        time_s=torch.arange(3.0 * n, dtype=torch.float64),
    )
    fit = fit_of(rig, readings)
    wrong = _as_at_next(readings, (readings.sensor == 2).nonzero().flatten()[::3])
    assert stale_poses(fit, wrong) == []
