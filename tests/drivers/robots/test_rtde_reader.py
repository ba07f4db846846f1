"""The RTDE reader loses no package, reports gaps and stalls, and ends when closed."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import threading
import time
from functools import partial

import pytest

from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.protocols import FlangePose
from drivers.robots.rtde import PORT
from drivers.robots.rtde_reader import RtdeReader
from drivers.simulated.faults import Fault
from drivers.simulated.process import Simulator
from drivers.simulated.ur_server import serve_ur
from drivers.transport.tcp import TcpPort
from tests.drivers.rig import free_host

NAMES = ("actual_TCP_pose", "actual_q")


@pytest.fixture
def simulator(world):
    with Simulator(partial(serve_ur, world, 0, "5.11.1.108318", free_host())) as running:
        yield running


def connect(simulator, names=NAMES, on_loss=None):
    port = TcpPort(simulator.address, PORT, timeout_s=1.0)
    return RtdeReader(port, names, 500.0, timeout_s=2.0, on_loss=on_loss)


def n_gaps(samples):
    steps = [round(500 * (b.device_time_s - a.device_time_s)) for a, b in itertools.pairwise(samples)]
    return sum(step != 1 for step in steps)


@pytest.mark.parametrize("n_hogs", [0, 6])
def test_no_package_is_lost_while_nobody_reads_and_the_computer_is_busy(simulator, n_hogs):
    reader = connect(simulator)
    hogs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(n_hogs)]
    try:
        samples = reader.read_new(timeout_s=2.0)
        time.sleep(float(os.environ.get("COILCAL_RTDE_S", "2")))
        samples += reader.read_new(timeout_s=2.0)
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()
        reader.close()
    assert len(samples) > 800
    assert n_gaps(samples) == 0
    assert not any(sample.is_after_loss for sample in samples)


def test_all_values_of_a_package_are_of_one_cycle(simulator, world):
    reader = connect(simulator)
    target = FlangePose((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    world.move(0, target, 0.5)
    time.sleep(0.3)
    samples = reader.read_new(timeout_s=1.0)
    reader.close()
    assert len({sample.values["actual_q"] for sample in samples}) > 50  # it moves
    assert all(sample.values["actual_q"] == sample.values["actual_TCP_pose"] for sample in samples)


def test_packages_that_the_controller_left_out_are_told(simulator):
    reader = connect(simulator)
    samples = reader.read_new(timeout_s=1.0)
    simulator.faults.fault = Fault.STALL
    time.sleep(0.8)
    with pytest.raises(
        DeadlineExceeded, match=r"must send a package every 0.002 s; the last came 0\.\d\d s ago"
    ):
        reader.latest(at_most_s=0.1)
    simulator.faults.fault = Fault.NONE
    time.sleep(0.3)
    samples += reader.read_new(timeout_s=1.0)
    reader.close()
    assert sum(sample.is_after_loss for sample in samples) == n_gaps(samples) == 1


def test_a_broken_connection_hands_out_the_rest_then_says_so_at_once(simulator):
    losses = []
    reader = connect(simulator, on_loss=lambda: losses.append(time.monotonic()))
    time.sleep(0.1)
    simulator.faults.fault = Fault.DROP
    time.sleep(0.3)
    assert len(losses) == 1
    assert reader.is_lost
    assert reader.read_new(timeout_s=1.0)
    with pytest.raises(DeviceFault, match="must stay connected"):
        reader.read_new(timeout_s=1.0)
    with pytest.raises(DeviceFault, match="must stay connected"):
        reader.latest(at_most_s=1.0)
    reader.close()


def test_reading_after_a_moment_throws_away_what_is_older_and_nothing_else(simulator):
    reader = connect(simulator)
    time.sleep(0.2)
    now_s = time.monotonic()
    sample = reader.read_after(now_s, timeout_s=1.0)
    assert 0 < sample.host_monotonic_s - now_s < 0.1
    rest = reader.read_new(timeout_s=1.0)
    reader.close()
    assert rest[0].device_time_s - sample.device_time_s == pytest.approx(0.002)


def test_a_variable_that_is_not_there_is_a_fault_and_the_port_is_free_again(simulator):
    with pytest.raises(DeviceFault, match="wishes NOT_FOUND"):
        connect(simulator, ("wishes",))


def test_a_mute_controller_misses_the_deadline_of_the_set_up(simulator):
    simulator.faults.fault = Fault.STALL
    with pytest.raises(DeadlineExceeded):
        connect(simulator)
    simulator.faults.fault = Fault.NONE


def test_after_a_pause_of_the_whole_computer_the_packages_that_wait_are_heard_first(simulator):
    reader = connect(simulator)
    reader.read_new(timeout_s=1.0)
    simulator.faults.fault = Fault.STALL
    time.sleep(0.8)
    end_of_pause = threading.Timer(0.2, lambda: setattr(simulator.faults, "fault", Fault.NONE))
    end_of_pause.start()
    sample = reader.latest(at_most_s=0.6)  # the one before is older than that
    end_of_pause.join()
    reader.close()
    assert time.monotonic() - sample.host_monotonic_s < 0.6
