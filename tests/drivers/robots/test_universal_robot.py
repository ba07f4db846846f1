"""A UR arm through the real ur_rtde client, against a simulated controller on its own address."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from functools import partial

import pytest

from drivers.errors import DeadlineExceeded, DeviceFault, DriverError, Refused
from drivers.protocols import FlangePose
from drivers.robots.universal_robot import UniversalRobot
from drivers.simulated.faults import Fault
from drivers.simulated.process import Simulator
from drivers.simulated.ur_server import serve_ur
from drivers.simulated.world import CoilCircuit, World
from tests.drivers.rig import free_host
from tests.program import PYTHON, launched

HOME = FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0))
NEAR = FlangePose((0.3, 0.02, 0.2), (0.0, 3.0, 0.0))
FAR = FlangePose((0.3, 0.2, 0.2), (0.0, 3.0, 0.0))


@pytest.fixture
def world():
    return World([CoilCircuit(2.0, 0.0)], [HOME])


@pytest.fixture
def rig(world):
    """Simulator and arm."""
    with Simulator(partial(serve_ur, world, 0, "5.11.1.108318", free_host())) as simulator:
        arm = UniversalRobot(simulator.address, "UR3e")
        yield simulator, arm
        simulator.faults.fault = Fault.NONE
        with contextlib.suppress(DriverError):
            arm.close()


def later(delay_s, action):
    thread = threading.Timer(delay_s, action)
    thread.start()
    return thread


def travelled_m(world, start):
    return abs(world.snapshot().base_from_flange[0].position_m[1] - start)


def test_an_arm_that_stands_tells_by_what_it_is_held(rig):
    simulator, arm = rig
    arm.require_safe()
    simulator.faults.fault = Fault.EMERGENCY_STOP
    with pytest.raises(DeviceFault, match="must be free to move; its emergency stop is pressed"):  # noqa: PT012
        for _ in range(1000):
            arm.require_safe()
            time.sleep(0.01)


JOINTS_RAD = tuple((number - 0.05, number + 0.05) for number in (*HOME.position_m, *HOME.rotation_vector_rad))
"""The joints of the simulated arm are the numbers of its pose."""


def test_a_way_beyond_the_joint_limits_is_refused_though_both_its_ends_are_within(rig, world):
    simulator, _ = rig
    low_rad, high_rad = -3.05, 3.05
    limits = (*JOINTS_RAD[:4], (low_rad, high_rad), JOINTS_RAD[5])
    with UniversalRobot(simulator.address, "UR3e", joint_limits_rad=limits) as arm:
        beyond_half_a_turn = FlangePose(HOME.position_m, (0.0, -3.0, 0.0))
        with pytest.raises(Refused, match=r"arm.joint_5_rad must be within -3.05 and 3.05 on the way; 3.071"):
            arm.move_to(beyond_half_a_turn, speed_m_per_s=0.1, timeout_s=20.0)
    assert world.snapshot().base_from_flange == (HOME,)


def test_a_protective_stop_leaves_no_command_behind_that_runs_again(rig, world):
    """A restarted control script finds the old registers unless the client has cleared them first."""
    simulator, arm = rig
    timer = later(0.5, lambda: setattr(simulator.faults, "fault", Fault.PROTECTIVE_STOP))
    with pytest.raises(DeviceFault, match="protective stop"):
        arm.move_to(FAR, speed_m_per_s=0.05, timeout_s=20.0)
    timer.join()
    with socket.create_connection((simulator.address, 29999)) as dashboard:
        dashboard.sendall(b"unlock protective stop\n")
        time.sleep(0.5)
    stopped = world.snapshot().base_from_flange[0]
    with pytest.raises(Refused):  # uploads the script again, then finds out that this is out of reach
        arm.move_to(FlangePose((0.9, 0.0, 0.2), (0.0, 3.0, 0.0)), speed_m_per_s=0.1, timeout_s=20.0)
    time.sleep(0.5)
    assert world.snapshot().base_from_flange[0] == stopped


def test_a_motion_that_takes_too_long_is_stopped(rig, world):
    _, arm = rig
    arm.move_to(NEAR, speed_m_per_s=0.2, timeout_s=5.0)
    with pytest.raises(DeadlineExceeded, match="stopped on the way and stands"):
        arm.move_to(FAR, speed_m_per_s=0.05, timeout_s=0.5)
    assert not world.is_moving(0)


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        (Fault.PROTECTIVE_STOP, "protective stop: find out what it hit"),
        (Fault.EMERGENCY_STOP, "emergency stop is pressed"),
    ],
)
def test_a_safety_stop_ends_the_motion_with_one_clear_sentence(rig, world, fault, sentence):
    simulator, arm = rig
    arm.move_to(NEAR, speed_m_per_s=0.2, timeout_s=5.0)
    timer = later(0.3, lambda: setattr(simulator.faults, "fault", fault))
    with pytest.raises(DeviceFault, match=f"{sentence}.*the arm stands still"):
        arm.move_to(FAR, speed_m_per_s=0.05, timeout_s=10.0)
    timer.join()
    with pytest.raises(DeviceFault, match=sentence):
        arm.move_to(HOME, speed_m_per_s=0.05, timeout_s=10.0)
    assert not world.is_moving(0)


@pytest.mark.parametrize("fault", [Fault.DROP, Fault.STALL, Fault.MUTE])
def test_a_lost_network_stops_the_arm_by_its_watchdog(rig, world, fault):
    simulator, arm = rig
    arm.move_to(NEAR, speed_m_per_s=0.2, timeout_s=5.0)
    timer = later(0.3, lambda: setattr(simulator.faults, "fault", fault))
    begin_s = time.monotonic()
    with pytest.raises(DriverError):
        arm.move_to(FAR, speed_m_per_s=0.05, timeout_s=10.0)
    assert time.monotonic() - begin_s < 6.0
    timer.join()
    time.sleep(0.3)
    assert not world.is_moving(0)
    assert travelled_m(world, 0.02) < 0.05
    simulator.faults.fault = Fault.NONE
    assert arm.read_pose(timeout_s=2.0).value.position_m[0] == pytest.approx(0.3)
    arm.move_to(HOME, speed_m_per_s=0.2, timeout_s=5.0)  # a fresh child, asked for by this call


def test_an_arm_whose_child_is_killed_is_stopped_by_its_watchdog(rig, world):
    _, arm = rig
    arm.move_to(NEAR, speed_m_per_s=0.2, timeout_s=5.0)
    killed_at = []

    def kill():
        killed_at.append(world.snapshot().base_from_flange[0].position_m[1])
        os.kill(arm.motion_pid, signal.SIGKILL)

    timer = later(0.5, kill)
    with pytest.raises(DeviceFault, match="the process of .* ended with code -9.*the arm stands still"):
        arm.move_to(FAR, speed_m_per_s=0.02, timeout_s=10.0)
    timer.join()
    assert travelled_m(world, killed_at[0]) < 0.02 * 0.5
    arm.move_to(HOME, speed_m_per_s=0.2, timeout_s=5.0)


def test_an_arm_whose_child_does_not_answer_is_stopped_and_gets_another_child(rig, world):
    _, arm = rig
    arm.move_to(NEAR, speed_m_per_s=0.2, timeout_s=20.0)
    pid = arm.motion_pid
    os.kill(pid, signal.SIGSTOP)
    arm.stop(timeout_s=4.0)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    arm.move_to(HOME, speed_m_per_s=0.2, timeout_s=20.0)
    assert not world.is_moving(0)


def test_an_arm_stops_when_the_host_program_is_killed(rig, world):
    simulator, _ = rig
    program = f"""
    from drivers.protocols import FlangePose
    from drivers.robots.universal_robot import UniversalRobot
    if __name__ == "__main__":
        arm = UniversalRobot({simulator.address!r}, "UR3e")
        arm.move_to(FlangePose((0.3, 0.001, 0.2), (0.0, 3.0, 0.0)), speed_m_per_s=0.1, timeout_s=5.0)
        print("ready", flush=True)
        arm.move_to(FlangePose((0.3, 0.2, 0.2), (0.0, 3.0, 0.0)), speed_m_per_s=0.02, timeout_s=20.0)
    """
    client = launched(PYTHON, "-c", textwrap.dedent(program), stderr=subprocess.DEVNULL)
    while client.stdout.readline() != "ready\n":  # ur_rtde prints as well
        assert client.poll() is None
    time.sleep(0.5)
    assert world.is_moving(0)
    killed_at_m = world.snapshot().base_from_flange[0].position_m[1]
    client.kill()
    client.wait()
    client.stdout.close()
    time.sleep(0.5)
    assert not world.is_moving(0)
    assert travelled_m(world, killed_at_m) < 0.02 * 0.3


class Pauses:
    """Gives a process no time for 0.3 s, longer than the watchdog of the controller waits, again and again."""

    def __init__(self, pid):
        self.pid, self.is_over = pid, threading.Event()
        self.thread = threading.Thread(target=self.pause)
        self.n = 0

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.is_over.set()
        self.thread.join()

    def pause(self):
        while not self.is_over.wait(0.25):
            os.kill(self.pid, signal.SIGSTOP)
            time.sleep(0.3)
            os.kill(self.pid, signal.SIGCONT)
            self.n += 1


@pytest.mark.parametrize("process", ["child", "simulator"])
def test_legal_moves_are_made_though_a_process_gets_no_time_for_a_while(rig, world, process):
    simulator, arm = rig
    arm.move_to(NEAR, speed_m_per_s=0.2, timeout_s=20.0)
    pid = arm.motion_pid if process == "child" else simulator.pid
    with Pauses(pid) as pauses:
        for target in (HOME, NEAR, HOME, NEAR):
            arm.move_to(target, speed_m_per_s=0.05, timeout_s=30.0)
            assert world.snapshot().base_from_flange[0].position_m == pytest.approx(
                target.position_m, abs=1e-3
            )
    assert pauses.n > 2
    assert arm.motion_pid == pid or process == "simulator"


def test_legal_moves_are_made_beside_busy_processes(rig, world):
    _, arm = rig
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(6)]
    try:
        for target in (NEAR, HOME, NEAR, HOME):
            arm.move_to(target, speed_m_per_s=0.1, timeout_s=30.0)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert world.snapshot().base_from_flange[0].position_m == pytest.approx(HOME.position_m)


def test_a_program_that_somebody_stops_in_mid_motion_is_not_started_again_by_itself(rig, world):
    simulator, arm = rig
    arm.move_to(NEAR, speed_m_per_s=0.2, timeout_s=20.0)

    def stop():
        with socket.create_connection((simulator.address, 29999)) as dashboard:
            dashboard.sendall(b"stop\n")
            time.sleep(0.5)

    timer = later(0.5, stop)
    with pytest.raises(DeviceFault, match="must finish its motion; its program is not running"):
        arm.move_to(FAR, speed_m_per_s=0.05, timeout_s=20.0)
    timer.join()
    stopped = world.snapshot().base_from_flange[0]
    time.sleep(0.5)
    assert world.snapshot().base_from_flange[0] == stopped


def test_an_arm_that_is_held_before_its_first_motion_says_by_what(rig):
    simulator, arm = rig
    simulator.faults.fault = Fault.EMERGENCY_STOP
    time.sleep(0.3)
    with pytest.raises(DeviceFault, match="must start its control script; its emergency stop is pressed"):
        arm.move_to(NEAR, speed_m_per_s=0.2, timeout_s=20.0)
