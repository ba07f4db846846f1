"""Fixtures of `tests.drivers.rig` for all tests of the drivers."""

from __future__ import annotations

from tests.drivers import rig

world, started = rig.world, rig.started
