"""Whoever interrupts a rig hears what could not be brought to rest."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.errors import DeviceFault
from drivers.guarded import GuardedArm
from drivers.open import DeviceSet
from drivers.safety import ArmLimits
from estimator.cli.instruments import Bench
from estimator.rig.rig import Rig
from tests.drivers.memory import MemoryArm

BOX = ArmLimits((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0), highest_speed_m_per_s=0.1)


@pytest.fixture
def bench(small_rig: Rig, monkeypatch: pytest.MonkeyPatch) -> tuple[Bench, DeviceSet, MemoryArm]:
    devices, arm = DeviceSet(), MemoryArm()
    devices.arms["arm1"] = GuardedArm(arm, BOX, devices.interlock, name="arm1")
    monkeypatch.setattr(Bench, "open", lambda self: devices)
    return Bench(small_rig, {}, Path("rig.yaml")), devices, arm


def interrupted(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def unstoppable(**_: object) -> None:
    raise DeviceFault("the cable is out")


def move(devices: DeviceSet, arm: MemoryArm) -> None:
    devices.arms["arm1"].move_to(arm.pose, speed_m_per_s=0.05, timeout_s=1.0)


def test_an_arm_that_cannot_be_stopped_is_named_after_ctrl_c(bench):
    opened, devices, arm = bench
    arm.move_to, arm.stop = interrupted, unstoppable
    with (
        pytest.raises(DeviceFault, match="interrupted; arm1 is not known to be at rest: the cable is out"),
        opened.opened(),
    ):
        move(devices, arm)


def test_ctrl_c_stays_what_it_is_where_all_is_at_rest(bench):
    opened, devices, arm = bench
    arm.move_to = interrupted
    with pytest.raises(KeyboardInterrupt), opened.opened():
        move(devices, arm)
    assert arm.told[-1] == ("stop",)
