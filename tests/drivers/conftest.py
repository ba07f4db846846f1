"""Fixtures of `tests.drivers.rig` for all tests of the drivers."""

from __future__ import annotations

import pytest

from tests.drivers import replay, rig

world, started = rig.world, rig.started


@pytest.fixture(autouse=True)
def whole_conversations():
    """A driver that leaves out what it had to send passes no test."""
    replay.played.clear()
    yield
    assert all(port.is_over for port in replay.played), "a conversation did not come to its end"
