"""Sessions are stacked where their predictions are the same."""

from __future__ import annotations

from dataclasses import replace

from estimator.batching.stacked import settings_hash


def test_what_supplies_measured_does_not_keep_sessions_apart(small_session):
    readings = small_session.observations
    measured = replace(readings, current_measured_A=1.001 * readings.current_A)
    known = settings_hash(small_session.rig, readings)
    assert settings_hash(small_session.rig, measured) == known
    assert settings_hash(small_session.rig, replace(readings, current_A=2.0 * readings.current_A)) != known
