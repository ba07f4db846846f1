"""Every arm keeps its contract, over the real ur_rtde client against a simulated controller in another process."""

from __future__ import annotations

import contextlib
import itertools
import re
import threading
import time
from types import SimpleNamespace

import pytest

from drivers.entries import ARMS
from drivers.errors import DeadlineExceeded, DeviceFault, DriverError, Refused
from drivers.open import open_devices
from drivers.protocols import FlangePose, ReadingFlag, RobotArm
from drivers.rotation import angle_between_rad
from drivers.simulated.rig import SimulatedRig
from tests.drivers.rig import free_host

TIMEOUT_S = 20.0
"""The client of ur_rtde takes a second to start, and more on a busy computer."""

HOME = FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0))
TURNED = FlangePose((0.31, 0.02, 0.19), (0.0, 3.1, 0.1))
FAR = FlangePose((0.3, 0.25, 0.2), (0.0, 3.0, 0.0))
SECTION = {
    "workspace_low_mm": [0, -300, 0],
    "workspace_high_mm": [900, 300, 500],
    "highest_speed_mm_per_s": 200,
    "joint_low_deg": [-360] * 6,
    "joint_high_deg": [360, 360, 360, 360, 180, 360],
}
"""The joints of the simulated arm are the numbers of its pose."""


@pytest.fixture
def rig(request):
    """An arm behind the limits of its section, with its simulator; `address` is what an operator knows it by.

    One model stands for all, which differ by name alone.
    """
    section = {"arm1": {**SECTION, "arm": getattr(request, "param", "ur3e")}}
    with SimulatedRig(section, {}, circuits=[], homes=[HOME], first_host=free_host()) as running:
        devices = open_devices(running.section)
        yield SimpleNamespace(
            arm=devices.arms["arm1"],
            interlock=devices.interlock,
            world=running.world,
            unplug=running.simulators["arm1"].close,
            address=running.section["arm1"]["host"],
        )
        with contextlib.suppress(DriverError):  # it may have been unplugged
            devices.close()


def stands_m(rig):
    return rig.world.snapshot().base_from_flange[0].position_m


def begin_to_move(rig):
    """A motion that goes on, in a thread; what it raised is in a list."""
    raised = []

    def move():
        try:
            rig.arm.move_to(FAR, speed_m_per_s=0.02, timeout_s=TIMEOUT_S)
        except Exception as error:
            raised.append(error)

    thread = threading.Thread(target=move)
    thread.start()
    deadline_s = time.monotonic() + TIMEOUT_S
    while stands_m(rig)[1] < 1e-3:
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    return thread, raised


@pytest.mark.parametrize("rig", sorted(ARMS), indirect=True)
def test_an_arm_of_any_model_identifies_itself(rig):
    assert isinstance(rig.arm, RobotArm)
    assert rig.arm.identify(timeout_s=TIMEOUT_S).startswith("Universal Robots, UR3, ")


def test_poses_are_counted_dated_and_flagged(rig):
    readings = [rig.arm.read_pose(timeout_s=TIMEOUT_S) for _ in range(5)]
    assert [reading.sequence for reading in readings] == list(range(5))
    assert all(reading.value == HOME for reading in readings)
    assert not any(ReadingFlag.STALE in reading.flags for reading in readings)
    assert abs(readings[-1].host_monotonic_s - time.monotonic()) < 1.0
    for earlier, later in itertools.pairwise(readings):
        assert earlier.host_monotonic_s <= later.host_monotonic_s
        assert earlier.device_time_s < later.device_time_s


def test_a_motion_ends_where_it_was_asked_to(rig):
    rig.arm.move_to(TURNED, speed_m_per_s=0.1, timeout_s=TIMEOUT_S)
    assert not rig.world.is_moving(0)
    assert stands_m(rig) == pytest.approx(TURNED.position_m, abs=5e-4)
    pose = rig.arm.read_pose(timeout_s=TIMEOUT_S).value
    assert pose.position_m == pytest.approx(TURNED.position_m, abs=5e-4)
    assert angle_between_rad(pose.rotation_vector_rad, TURNED.rotation_vector_rad) < 2e-3


@pytest.mark.parametrize(
    ("target", "speed_m_per_s", "message"),
    [
        (FlangePose((0.3, 0.4, 0.2), HOME.rotation_vector_rad), 0.1, "arm.target.y_m must be within"),
        (FAR, 0.3, "arm.speed_m_per_s must be > 0 and at most 0.2; received 0.3"),
        (FlangePose(HOME.position_m, (0.0, 3.2, 0.0)), 0.1, "arm.joint_5_rad must be within"),
        (FlangePose((0.8, 0.0, 0.2), HOME.rotation_vector_rad), 0.1, "the safety limits of the controller"),
    ],
)
def test_a_motion_beyond_a_limit_is_refused_before_anything_moves(rig, target, speed_m_per_s, message):
    with pytest.raises(Refused, match=message):
        rig.arm.move_to(target, speed_m_per_s=speed_m_per_s, timeout_s=TIMEOUT_S)
    time.sleep(0.2)
    assert rig.world.snapshot().base_from_flange == (HOME,)
    assert rig.interlock.reason is None  # what was refused is no fault


@pytest.mark.parametrize("call", ["identify", "read_pose", "require_safe", "move_to"])
def test_a_lost_connection_is_a_fault_that_names_the_address(rig, call):
    rig.arm.read_pose(timeout_s=TIMEOUT_S)
    rig.unplug()
    end_s = time.monotonic() + TIMEOUT_S
    calls = {
        "identify": lambda: rig.arm.identify(timeout_s=2.0),
        "read_pose": lambda: rig.arm.read_pose(timeout_s=2.0),
        "require_safe": rig.arm.require_safe,
        "move_to": lambda: rig.arm.move_to(TURNED, speed_m_per_s=0.1, timeout_s=2.0),
    }
    with pytest.raises((DeviceFault, DeadlineExceeded), match=re.escape(rig.address)):  # noqa: PT012
        while time.monotonic() < end_s:  # what arrived before may still be read
            calls[call]()
            time.sleep(0.01)


def test_a_connection_lost_in_mid_motion_is_a_fault_that_names_the_address(rig):
    thread, raised = begin_to_move(rig)
    rig.unplug()
    thread.join(TIMEOUT_S)
    (error,) = raised
    assert isinstance(error, DeviceFault | DeadlineExceeded)
    assert rig.address in str(error)
    assert "whether the arm stands still is unknown" in str(error)


def test_stop_ends_a_motion_and_leaves_the_arm_standing(rig):
    thread, raised = begin_to_move(rig)
    rig.arm.stop(timeout_s=5.0)
    stopped_m = stands_m(rig)
    assert not rig.world.is_moving(0)
    thread.join(TIMEOUT_S)
    assert [type(error) for error in raised] == [DeviceFault]
    time.sleep(0.3)
    assert stands_m(rig) == pytest.approx(stopped_m)
    assert stopped_m[1] < 0.5 * FAR.position_m[1]


def test_an_arm_that_stands_can_be_stopped_and_closed_twice(rig):
    rig.arm.stop(timeout_s=5.0)
    assert rig.world.snapshot().base_from_flange == (HOME,)
    rig.arm.close()
    rig.arm.close()
