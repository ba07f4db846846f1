"""How far an arm may stand off its target, and its tool centre point off its flange: to the tolerance and not ten times as far."""

from __future__ import annotations

import math
import sys
import threading
from types import SimpleNamespace

import pytest

from drivers.errors import DeviceFault
from drivers.protocols import FlangePose
from drivers.robots import ur_motion
from drivers.robots.rtde_reader import Sample
from drivers.robots.ur_motion import UrMotion

TARGET = FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0))
OBEYS = {"safety_status_bits": 1, "runtime_state": 2}


def arrived(monkeypatch, *, off_m=0.0, off_rad=0.0):
    """An arm that stands off its target."""
    (x_m, y_m, z_m), (x_rad, y_rad, z_rad) = TARGET.position_m, TARGET.rotation_vector_rad
    values = {**OBEYS, "actual_TCP_pose": (x_m, y_m + off_m, z_m, x_rad, y_rad + off_rad, z_rad)}
    motion = object.__new__(UrMotion)
    motion._name = "arm at a test"
    monkeypatch.setattr(UrMotion, "_fresh_sample", lambda _: Sample(0.0, 0.0, values, is_after_loss=False))
    motion._check_arrival(TARGET)


@pytest.mark.parametrize("off", [{"off_m": 4.9e-4}, {"off_m": -4.9e-4}, {"off_rad": 1.9e-3}])
def test_an_arm_has_arrived_within_half_a_millimetre_and_two_milliradians(monkeypatch, off):
    arrived(monkeypatch, **off)


@pytest.mark.parametrize("off", [{"off_m": 5.1e-4}, {"off_m": -5.1e-4}, {"off_rad": -2.1e-3}])
def test_an_arm_has_not_arrived_a_little_beyond(monkeypatch, off):
    with pytest.raises(DeviceFault, match="must arrive within 0.5 mm and 2 mrad"):
        arrived(monkeypatch, **off)


@pytest.mark.parametrize(("offset_m", "is_right"), [(0.9e-6, True), (1.1e-6, False)])
def test_a_tool_centre_point_off_the_flange_is_refused(monkeypatch, offset_m, is_right):
    control = SimpleNamespace(
        setWatchdog=lambda _: True, getTCPOffset=lambda: [0.0, offset_m, 0.0] + [0.0] * 3
    )
    library = SimpleNamespace(RTDEControlInterface=lambda *_: control)
    monkeypatch.setitem(sys.modules, "rtde_control", library)
    for name in ("TcpPort", "RtdeReader", "run_ahead"):
        monkeypatch.setattr(ur_motion, name, lambda *_, **__: None)
    limits_rad = ((-math.pi, math.pi),) * 6
    if is_right:
        UrMotion("a test", 500.0, limits_rad, threading.Event())
        return
    with pytest.raises(DeviceFault, match="must have its tool centre point at the flange"):
        UrMotion("a test", 500.0, limits_rad, threading.Event())
