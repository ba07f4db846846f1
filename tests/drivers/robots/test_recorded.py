"""A recorded arm gives the recorded answers with the recorded timing, and to no other questions."""

from __future__ import annotations

import dataclasses
import time

import pytest

from drivers.errors import DeadlineExceeded, DeviceFault, DriverError, Refused
from drivers.protocols import ReadingFlag, RobotArm
from drivers.robots.recorded import RecordingArm, ReplayedArm
from tests.drivers.memory import HOME, MemoryArm

THERE = dataclasses.replace(HOME, position_m=(0.3, 0.1, 0.4))
NOWHERE = dataclasses.replace(HOME, position_m=(9.0, 0.1, 0.4))


class Arm(MemoryArm):
    """Has its own clock; `error` and `lasts_s` set how its next motion ends."""

    flags = ReadingFlag.STALE | ReadingFlag.DROPPED
    error = None
    lasts_s = 0.0

    def read_pose(self, *, timeout_s):
        return self.counter.reading(self.pose, self.flags, device_time_s=0.1 + 0.2)

    def move_to(self, base_from_flange, *, speed_m_per_s, timeout_s):
        time.sleep(self.lasts_s)
        if self.error is not None:
            raise self.error
        super().move_to(base_from_flange, speed_m_per_s=speed_m_per_s, timeout_s=timeout_s)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "arm1.txt"


@pytest.fixture
def recorded(path):
    arm = Arm()
    with RecordingArm(arm, path, name="arm1") as recording:
        yield arm, recording
    assert arm.is_closed


def test_what_was_asked_is_answered_as_then_and_counted_anew(path, recorded):
    arm, recording = recorded
    assert isinstance(recording, RobotArm)
    identity = recording.identify(timeout_s=1.0)
    first = recording.read_pose(timeout_s=1.0)
    recording.move_to(THERE, speed_m_per_s=0.1, timeout_s=1.0)
    arm.flags = ReadingFlag.NONE
    second = recording.read_pose(timeout_s=1.0)
    assert (identity, second.value) == (arm.identify(timeout_s=1.0), THERE)
    with ReplayedArm(path) as replay:
        assert isinstance(replay, RobotArm)
        assert replay.identify(timeout_s=1.0) == identity
        begin_s = time.monotonic()
        again = replay.read_pose(timeout_s=1.0)
        assert begin_s <= again.host_monotonic_s <= time.monotonic()
        assert dataclasses.replace(again, host_monotonic_s=first.host_monotonic_s) == first
        replay.move_to(THERE, speed_m_per_s=0.1, timeout_s=1.0)
        again = replay.read_pose(timeout_s=1.0)
        assert dataclasses.replace(again, host_monotonic_s=second.host_monotonic_s) == second


@pytest.mark.parametrize("kind", [Refused, DeviceFault, DeadlineExceeded])
def test_a_motion_that_failed_fails_as_then_and_what_came_after_follows(path, recorded, kind):
    arm, recording = recorded
    arm.error = kind("the arm met a “wall”")
    with pytest.raises(kind):
        recording.move_to(NOWHERE, speed_m_per_s=0.1, timeout_s=1.0)
    recording.read_pose(timeout_s=1.0)
    with ReplayedArm(path) as replay:
        with pytest.raises(kind, match="the arm met a “wall”, as recorded in .*arm1.txt"):
            replay.move_to(NOWHERE, speed_m_per_s=0.1, timeout_s=1.0)
        assert replay.read_pose(timeout_s=1.0).value == HOME


def test_a_motion_takes_as_long_as_then(path, recorded):
    arm, recording = recorded
    arm.lasts_s = 0.3
    recording.move_to(THERE, speed_m_per_s=0.1, timeout_s=1.0)
    with ReplayedArm(path) as replay:
        begin_s = time.monotonic()
        replay.move_to(THERE, speed_m_per_s=0.1, timeout_s=20.0)
        assert time.monotonic() - begin_s >= 0.29
    with ReplayedArm(path) as replay, pytest.raises(DeadlineExceeded):
        replay.move_to(THERE, speed_m_per_s=0.1, timeout_s=0.1)


@pytest.mark.parametrize(("target", "speed_m_per_s"), [(NOWHERE, 0.1), (THERE, 0.2)])
def test_another_motion_is_none_of_the_recording(path, recorded, target, speed_m_per_s):
    recorded[1].move_to(THERE, speed_m_per_s=0.1, timeout_s=1.0)
    with (
        ReplayedArm(path) as replay,
        pytest.raises(
            DeviceFault, match=r"arm1.txt must be sent b'move_to .* 0.1\\n' next; received b'move_to"
        ),
    ):
        replay.move_to(target, speed_m_per_s=speed_m_per_s, timeout_s=1.0)


def test_the_end_of_the_recording_is_said(path, recorded):
    recorded[1].read_pose(timeout_s=1.0)
    with ReplayedArm(path) as replay:
        replay.read_pose(timeout_s=1.0)
        for _ in range(2):
            with pytest.raises(DeviceFault, match="must be sent nothing more: the recording ends here"):
                replay.read_pose(timeout_s=1.0)


def test_stopping_and_asking_for_safety_is_no_part_of_a_recording(path, recorded):
    arm, recording = recorded
    arm.held_by = "somebody"
    with pytest.raises(DeviceFault, match="somebody"):
        recording.require_safe()
    recording.stop(timeout_s=1.0)
    assert arm.told == [("stop",)]
    assert path.read_text() == ""
    with ReplayedArm(path) as replay:
        replay.require_safe()
        replay.stop(timeout_s=1.0)


@pytest.mark.parametrize(
    "answer", [b"hm", b"{}", b"null", b'{"pose": [1, 2], "device_time_s": 0, "flags": []}']
)
def test_what_is_no_recording_of_an_arm_is_told_with_its_file(path, answer):
    path.write_text(f"0.1 > {b'read_pose' + bytes([10])!r}\n0.2 < {answer + bytes([10])!r}\n")
    with ReplayedArm(path) as replay, pytest.raises(DeviceFault, match=r"received .*\(.*arm1.txt\)"):
        replay.read_pose(timeout_s=1.0)


def test_a_recording_that_is_not_there_is_a_fault(tmp_path):
    with pytest.raises(DeviceFault, match="none.txt must be readable as a transcript"):
        ReplayedArm(tmp_path / "none.txt")


def test_a_full_disk_ends_the_recording_and_the_arm_goes_on(tmp_path, caplog):
    full = tmp_path / "full"
    full.symlink_to("/dev/full")
    arm = Arm()
    with RecordingArm(arm, full, name="arm1") as recording:
        for target in (THERE, HOME):
            recording.move_to(target, speed_m_per_s=0.1, timeout_s=1.0)
    assert [command[1] for command in arm.told] == [THERE.position_m, HOME.position_m]
    assert caplog.text.count("the recording of arm1 ends here") == 1


def test_a_closed_replay_says_so(path, recorded):
    recorded[1].read_pose(timeout_s=1.0)
    replay = ReplayedArm(path)
    replay.close()
    replay.close()
    with pytest.raises(DriverError, match="must be open; it was closed"):
        replay.read_pose(timeout_s=1.0)
