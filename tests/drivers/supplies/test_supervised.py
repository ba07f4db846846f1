"""A supervised supply is switched off when the program that uses it is gone."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
import time
from functools import partial
from pathlib import Path

import pytest

from drivers.errors import DeviceFault
from drivers.pulse import SILENT_S
from drivers.simulated.faults import Fault
from drivers.simulated.process import Simulator
from drivers.simulated.supplies import simulated_kepco, simulated_scpi_supply
from drivers.simulated.world import CoilCircuit, World
from drivers.supplies.ramped import RampedSource
from drivers.supplies.scpi import KEPCO_BOP, ScpiSupply
from drivers.supplies.supervised import SupervisedSource
from drivers.transport.serial_port import SerialPort, SerialSettings
from tests.program import launched

SLEW_A_PER_S = 5.0
LONGER_THAN_ONE_ATTEMPT_S = 10.0
"""Of the child of a program that is gone: 7 s for its largest current, and what an answer may take."""


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


class Host:
    """A program of its own that lets 4 A flow, and may be killed or stopped."""

    def __init__(self, address, opens="open_source"):
        program = f"""
        import time
        from tests.drivers.supplies.test_supervised import {opens}
        if __name__ == "__main__":
            source = {opens}({address!r})
            source.set_current_A(4.0, timeout_s=5.0)
            print(source.pid, flush=True)
            time.sleep(60)
        """
        command = [sys.executable, "-c", textwrap.dedent(program)]
        # A process group of its own, as a shell gives it to what Ctrl-Z will stop.
        self.process = launched(*command, stderr=subprocess.DEVNULL, process_group=0)
        self.child_pid = int(self.process.stdout.readline())

    def end(self):
        self.process.stdout.close()
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait(20)


@pytest.fixture
def host(supply, world):
    running = Host(supply.address)
    assert world.snapshot().currents_A[0] == pytest.approx(4.0)
    yield running
    running.end()


def falls_in_steps(world, timeout_s):
    """Wait until no current flows, and say whether it was ramped."""
    seen_A = []

    def is_off():
        seen_A.append(world.snapshot().currents_A[0])
        return seen_A[-1] == 0.0

    wait_until(is_off, timeout_s)
    return len({round(current_A, 3) for current_A in seen_A}) > 4


@pytest.mark.parametrize("sign", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_the_current_ramps_to_zero_when_the_host_program_is_killed(host, world, sign):
    host.process.send_signal(sign)
    assert falls_in_steps(world, 6.0), "it was switched off without a ramp"


@pytest.mark.parametrize("sign", [signal.SIGSTOP, signal.SIGTSTP])
def test_the_current_ramps_to_zero_when_the_host_program_is_stopped(host, world, sign):
    """SIGTSTP is what Ctrl-Z sends to all processes of a job."""
    os.killpg(host.process.pid, sign)
    assert falls_in_steps(world, SILENT_S + 10.0), "it was switched off without a ramp"


@pytest.mark.parametrize("sign", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_frozen_supply_is_off_as_soon_as_it_takes_commands_again_though_its_program_is_gone(
    host, supply, world, sign
):
    supply.faults.fault = Fault.STALL
    host.process.send_signal(sign)
    time.sleep(LONGER_THAN_ONE_ATTEMPT_S)
    assert world.snapshot().currents_A[0] == pytest.approx(4.0)
    supply.faults.fault = Fault.NONE
    wait_until(lambda: world.snapshot().currents_A[0] == 0.0, 5.0)
    wait_until(lambda: has_ended(host.child_pid), 20.0)


def test_a_mute_supply_is_told_off_as_long_as_it_does_not_confirm_it(host, supply, world):
    supply.faults.fault = Fault.MUTE
    host.process.kill()
    wait_until(lambda: world.snapshot().currents_A[0] == 0.0, 10.0)
    time.sleep(LONGER_THAN_ONE_ATTEMPT_S)
    assert not has_ended(host.child_pid)
    world.drive(0, 3.0)  # what it was told was lost, say
    wait_until(lambda: world.snapshot().currents_A[0] == 0.0, 5.0)
    supply.faults.fault = Fault.NONE
    wait_until(lambda: has_ended(host.child_pid), 20.0)


def test_who_waits_for_the_end_of_a_program_does_not_wait_for_a_child_that_insists(supply):
    program = f"""
    from tests.drivers.supplies.test_supervised import open_source
    if __name__ == "__main__":
        with open_source({supply.address!r}) as source:
            source.set_current_A(4.0, timeout_s=5.0)
            print(source.pid, flush=True)
            input()
    """
    command = [sys.executable, "-c", textwrap.dedent(program)]
    host = launched(*command, stdin=subprocess.PIPE)
    child_pid = int(host.stdout.readline())
    supply.faults.fault = Fault.MUTE
    begin_s = time.monotonic()
    _, said = host.communicate("\n", timeout=60)
    assert time.monotonic() - begin_s < 25.0
    assert host.returncode == 1
    assert "an answer must end with" in said
    assert not has_ended(child_pid)
    os.kill(child_pid, signal.SIGTERM)
    wait_until(lambda: has_ended(child_pid), 5.0)


def test_a_child_that_is_stopped_is_noticed_replaced_and_the_supply_switched_off(supply, world):
    with open_source(supply.address) as source:
        source.set_current_A(2.0, timeout_s=3.0)
        source.require_alive()
        stopped = source.pid
        os.kill(stopped, signal.SIGSTOP)
        begin_s = time.monotonic()
        with pytest.raises(DeviceFault, match="coil1 must give signs of life; it has given none for 5 s"):
            source.read_current_A(timeout_s=60.0)
        assert time.monotonic() - begin_s < SILENT_S + 5.0
        with pytest.raises(DeviceFault, match="must give signs of life"):
            source.require_alive()
        assert world.snapshot().currents_A[0] == pytest.approx(2.0)
        source.output_off(timeout_s=5.0)
        assert world.snapshot().currents_A == (0.0,)
        assert source.pid != stopped
        assert has_ended(stopped)


@pytest.mark.parametrize("end", ["output_off", "close"])
def test_a_child_that_is_stopped_while_nobody_asked_is_replaced_where_it_must_switch_off(supply, world, end):
    source = open_source(supply.address)
    source.set_current_A(2.0, timeout_s=3.0)
    os.kill(source.pid, signal.SIGSTOP)
    {"output_off": lambda: source.output_off(timeout_s=3.0), "close": source.close}[end]()
    assert world.snapshot().currents_A == (0.0,)
    source.close()


def test_a_dead_child_of_a_supply_that_was_only_looked_at_is_not_replaced(supply, world):
    world.drive(0, 1.5)
    source = open_source(supply.address)
    source.read_current_A(timeout_s=3.0)
    os.kill(source.pid, signal.SIGKILL)
    wait_until(lambda: source._supervised.has_ended, 5.0)
    source.close()
    assert world.snapshot().currents_A[0] == pytest.approx(1.5)


WATCHDOG_S = 4.0


def make_watched_source(address, interrupt):
    supply = ScpiSupply(
        SerialPort(address, SerialSettings(9600)),
        lowest_A=0.0,
        highest_A=5.0,
        compliance_V=20.0,
        resolution_A=1e-3,
        watchdog_s=WATCHDOG_S,
    )
    return RampedSource(supply, slew_A_per_s=SLEW_A_PER_S, interrupt=interrupt)


def open_watched_source(address):
    return SupervisedSource(
        partial(make_watched_source, address), "coil1", slew_A_per_s=SLEW_A_PER_S, longest_off_s=10.0
    )


@pytest.fixture
def watchful_supply(world):
    with Simulator.on_serial_line(partial(simulated_scpi_supply, world, 0, 5.0)) as simulator:
        yield simulator


@pytest.mark.parametrize("sign", [signal.SIGSTOP, signal.SIGKILL])
def test_a_supply_with_a_watchdog_switches_itself_off_when_program_and_child_are_stopped_or_killed(
    watchful_supply, world, sign
):
    host = Host(watchful_supply.address, "open_watched_source")
    time.sleep(1.5 * WATCHDOG_S)
    assert world.snapshot().currents_A[0] == pytest.approx(4.0)  # its child asks often enough
    os.kill(host.child_pid, signal.SIGSTOP)  # first, so that it cannot notice the end of its program
    host.process.send_signal(sign)
    os.kill(host.child_pid, sign)
    wait_until(lambda: world.snapshot().currents_A[0] == 0.0, WATCHDOG_S + 2.0)
    with contextlib.suppress(ProcessLookupError):
        os.kill(host.child_pid, signal.SIGKILL)
    host.end()


def test_the_watchdog_of_a_supply_that_is_off_is_stopped_lest_it_latches(watchful_supply):
    with open_watched_source(watchful_supply.address) as source:
        source.set_current_A(1.0, timeout_s=5.0)
    time.sleep(1.2 * WATCHDOG_S)
    with open_watched_source(watchful_supply.address) as source:
        source.set_current_A(1.0, timeout_s=5.0)
        assert source.read_current_A(timeout_s=2.0).value == pytest.approx(1.0)


def has_ended(pid):
    """Whether a process has ended; one that nobody has waited for yet is a zombie."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return True
    return state == "Z"


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
