"""A supervised supply is switched off when the program that uses it is gone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from functools import partial

import pytest

from drivers.errors import DeviceFault
from drivers.protocols import CurrentSource
from drivers.simulated.faults import Fault
from drivers.simulated.process import Simulator
from drivers.simulated.supplies import simulated_kepco
from drivers.simulated.world import CoilCircuit, World
from drivers.supplies.ramped import RampedSource
from drivers.supplies.scpi import KEPCO_BOP, ScpiSupply
from drivers.supplies.supervised import SupervisedSource
from drivers.transport.serial_port import SerialPort, SerialSettings

SLEW_A_PER_S = 5.0


def make_source(address, interrupt):
    port = SerialPort(address, SerialSettings(9600))
    supply = ScpiSupply(
        port, dialect=KEPCO_BOP, lowest_A=-5.0, highest_A=5.0, compliance_V=20.0, resolution_A=1e-3
    )
    return RampedSource(supply, slew_A_per_s=SLEW_A_PER_S, interrupt=interrupt)


def open_source(address):
    return SupervisedSource(
        partial(make_source, address), "coil1", slew_A_per_s=SLEW_A_PER_S, longest_off_s=10.0
    )


@pytest.fixture
def world():
    return World([CoilCircuit(2.0, 0.0)])


@pytest.fixture
def supply(world):
    with Simulator.on_serial_line(partial(simulated_kepco, world, 0, 5.0)) as simulator:
        yield simulator


def wait_until(condition, timeout_s):
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "it did not happen"
        time.sleep(0.01)


def test_a_supervised_source_is_a_source(supply, world):
    with open_source(supply.address) as source:
        assert isinstance(source, CurrentSource)
        assert source.identify(timeout_s=2.0).startswith("KEPCO")
        source.set_current_A(1.0, timeout_s=3.0)
        assert source.read_current_A(timeout_s=2.0).value == pytest.approx(1.0)
    assert world.snapshot().currents_A == (0.0,)


def test_errors_of_the_device_cross_the_process(supply):
    with open_source(supply.address) as source:
        with pytest.raises(ValueError, match="within -5 and 5; received 6"):
            source.set_current_A(6.0, timeout_s=3.0)
        supply.faults.fault = Fault.MUTE
        with pytest.raises(TimeoutError, match="must end with"):
            source.read_current_A(timeout_s=0.3)
        supply.faults.fault = Fault.NONE


def test_output_off_ends_the_ramp_of_another_thread(supply, world):
    with open_source(supply.address) as source:
        errors = []

        def ramp():
            try:
                source.set_current_A(5.0, timeout_s=5.0)
            except DeviceFault as error:
                errors.append(str(error))

        thread = threading.Thread(target=ramp)
        thread.start()
        wait_until(lambda: world.snapshot().currents_A[0] > 1.0, 3.0)
        source.output_off(timeout_s=5.0)
        assert world.snapshot().currents_A == (0.0,)
        thread.join()
        assert "interrupted" in errors[0]


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_the_current_ramps_to_zero_when_the_host_program_is_killed(supply, world, sign):
    program = f"""
    import time
    from tests.drivers.supplies.test_supervised import open_source
    if __name__ == "__main__":
        source = open_source({supply.address!r})
        source.set_current_A(4.0, timeout_s=5.0)
        print("ready", flush=True)
        time.sleep(60)
    """
    host = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert host.stdout.readline() == b"ready\n"
    assert world.snapshot().currents_A[0] == pytest.approx(4.0)
    host.send_signal(sign)
    host.stdout.close()
    seen_A = []

    def is_off():
        seen_A.append(world.snapshot().currents_A[0])
        return seen_A[-1] == 0.0

    wait_until(is_off, 6.0)
    host.wait(20)
    steps_A = {round(current_A, 3) for current_A in seen_A}
    assert len(steps_A) > 4, "it was switched off without a ramp"


def test_a_source_whose_child_is_killed_says_so_and_a_new_child_switches_it_off(supply, world):
    source = open_source(supply.address)
    source.set_current_A(2.0, timeout_s=3.0)
    os.kill(source.pid, signal.SIGKILL)
    with pytest.raises(DeviceFault, match="the process of coil1 must be running; it ended with code -9"):
        source.read_current_A(timeout_s=2.0)
    assert world.snapshot().currents_A[0] == pytest.approx(2.0)
    source.output_off(timeout_s=5.0)
    assert world.snapshot().currents_A == (0.0,)
    source.set_current_A(1.0, timeout_s=3.0)
    os.kill(source.pid, signal.SIGKILL)
    time.sleep(0.1)
    source.close()
    assert world.snapshot().currents_A == (0.0,)


def test_a_port_that_cannot_be_opened_is_told_at_once():
    with pytest.raises(DeviceFault, match="must open as a serial port"):
        open_source("/dev/no_such_port")
