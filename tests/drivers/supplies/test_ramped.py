"""A ramp has even steps, reads each back, ends on its target, and after any failure leads to zero."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeadlineExceeded, DeviceFault, DriverError, Refused
from drivers.supplies import ramped
from drivers.supplies.commands import Measured
from drivers.supplies.ramped import RampedSource, longest_off_s, ramp_steps

currents = st.floats(-20, 20)


@given(currents, currents, st.floats(0.1, 100), st.sampled_from([0.1, 0.25]))
def test_no_step_of_a_ramp_is_beyond_its_slew_rate_and_it_ends_on_the_target(
    start_A, target_A, slew_A_per_s, step_s
):
    steps_A = [start_A, *ramp_steps(start_A, target_A, slew_A_per_s, step_s)]
    assert steps_A[-1] == target_A
    largest_A = max(abs(b - a) for a, b in itertools.pairwise(steps_A))
    assert largest_A <= slew_A_per_s * step_s * (1 + 1e-6) + 1e-12


class MemorySupply:
    """A supply in memory; `fail_at` names the command that fails."""

    name = "supply"
    lowest_A, highest_A, resolution_A, step_s = -5.0, 5.0, 1e-3, 0.1
    watchdog_s = None

    def __init__(self):
        self.history = []
        self.set_point_A, self.is_on = 4.0, False
        self.fail_at = None
        self.is_closed = False

    def note(self, name, *arguments):
        self.history.append((name, *arguments))
        if self.fail_at == name:
            raise DeviceFault(f"{name} must work")

    def identify(self, deadline):
        return "memory"

    def prepare(self, deadline):
        self.note("prepare")

    def write_set_point(self, current_A, deadline):
        self.note("write", current_A)
        self.set_point_A = current_A

    def read_set_point_A(self, deadline):
        self.note("read")
        return self.set_point_A

    def switch_output(self, is_on, deadline):
        self.note("switch", is_on)
        self.is_on = is_on

    def is_output_on(self, deadline):
        self.note("is_on")
        return self.is_on

    def send_set_point(self, current_A, deadline):
        self.note("send", current_A)
        self.set_point_A = current_A

    def disarm(self, deadline):
        self.note("disarm")

    def cut(self, deadline):
        self.note("cut")
        self.set_point_A, self.is_on = 0.0, False

    def measure(self, deadline):
        return Measured(self.set_point_A if self.is_on else 0.0, True)

    def close(self):
        self.is_closed = True

    @property
    def written_A(self):
        """Requested currents, confirmed or not."""
        return [arguments[0] for name, *arguments in self.history if name in {"write", "send"}]


@pytest.fixture
def supply():
    return MemorySupply()


@pytest.fixture
def source(supply):
    return RampedSource(supply, slew_A_per_s=20.0)


def test_the_output_is_switched_on_at_zero_only(supply, source):
    source.set_current_A(5.0, timeout_s=2.0)
    commands = [entry for entry in supply.history if entry[0] in {"write", "switch"}]
    assert commands[:2] == [("write", 0.0), ("switch", True)]
    assert supply.written_A[1:] == pytest.approx([5 / 3, 10 / 3, 5.0])


def test_a_supply_that_is_already_on_is_ramped_from_its_present_current(supply, source):
    supply.is_on = True
    source.set_current_A(0.0, timeout_s=2.0)
    assert supply.written_A == pytest.approx([2.0, 0.0])


def test_the_same_current_again_sends_nothing(supply, source):
    source.set_current_A(1.0, timeout_s=2.0)
    n_commands = len(supply.history)
    source.set_current_A(1.0, timeout_s=2.0)
    assert len(supply.history) == n_commands


def test_a_set_point_that_was_not_taken_is_a_fault(supply, source):
    supply.read_set_point_A = lambda deadline: 0.5
    with pytest.raises(DeviceFault, match=r"set_point_A must be 0; the supply says 0.5 \(supply\)"):
        source.set_current_A(2.0, timeout_s=2.0)


def test_a_ramp_that_takes_longer_than_allowed_is_refused_before_it_begins(supply, source):
    source.set_current_A(0.0, timeout_s=1.0)
    with pytest.raises(Refused, match=r"a ramp from 0 to 5 A must be allowed 0.2 s; received 0.1 s"):
        source.set_current_A(5.0, timeout_s=0.1)
    assert supply.written_A == [0.0]


def test_a_ramp_that_runs_out_of_time_says_where_it_is(supply):
    source = RampedSource(supply, slew_A_per_s=10.0)
    source.set_current_A(0.0, timeout_s=1.0)
    supply.prepare = supply.identify
    slow = supply.write_set_point
    supply.write_set_point = lambda current_A, deadline: (time.sleep(0.2), slow(current_A, deadline))
    with pytest.raises(DeadlineExceeded, match=r"the ramp must end within 0.55 s; it is at"):
        source.set_current_A(5.0, timeout_s=0.55)


def test_switching_off_ramps_down_first(supply, source):
    source.set_current_A(4.0, timeout_s=2.0)
    supply.history.clear()
    source.output_off(timeout_s=2.0)
    assert not supply.is_on
    assert supply.history == [("send", 2.0), ("cut",), ("is_on",)]


def test_a_current_that_is_not_known_becomes_zero_at_once_for_a_ramp_might_begin_above_it(supply, source):
    supply.is_on, supply.set_point_A = True, 4.0
    source.output_off(timeout_s=2.0)
    assert supply.history == [("cut",), ("is_on",)]
    assert not supply.is_on


@pytest.mark.parametrize("failing", ["write", "read", "prepare", "send", "switch"])
def test_an_output_that_cannot_be_ramped_is_switched_off_at_once(supply, source, failing):
    source.set_current_A(4.0, timeout_s=2.0)
    supply.fail_at = failing
    source.output_off(timeout_s=2.0)
    assert not supply.is_on


def test_a_ramp_to_zero_without_time_for_it_is_left_out(supply):
    source = RampedSource(supply, slew_A_per_s=1.0)
    supply.is_on, supply.set_point_A = True, 4.0
    source.set_current_A(4.0, timeout_s=5.0)
    supply.history.clear()
    begin_s = time.monotonic()
    source.output_off(timeout_s=1.0)
    assert time.monotonic() - begin_s < 0.8
    assert not supply.is_on
    assert 1 <= len(supply.written_A) <= 5


def test_an_output_that_stays_on_is_told_again_until_the_time_is_over_and_is_a_fault(supply, source):
    source.set_current_A(1.0, timeout_s=2.0)
    supply.cut = lambda deadline: supply.note("cut")
    with pytest.raises(DeviceFault, match="must be off; the supply says it is on"):
        source.output_off(timeout_s=2.0)
    assert supply.history.count(("cut",)) >= 3


def test_an_output_that_does_not_come_on_is_a_fault(supply, source):
    supply.switch_output = lambda is_on, deadline: None
    with pytest.raises(DeviceFault, match="must be on; the supply says it is off"):
        source.set_current_A(1.0, timeout_s=2.0)


def test_after_a_fault_the_supply_is_asked_where_it_is(supply, source):
    source.set_current_A(4.0, timeout_s=2.0)
    supply.fail_at = "read"
    with pytest.raises(DriverError):
        source.set_current_A(0.0, timeout_s=2.0)
    supply.fail_at = None
    supply.history.clear()
    source.set_current_A(0.0, timeout_s=2.0)
    assert supply.history[:3] == [("prepare",), ("is_on",), ("read",)]
    assert supply.written_A == [0.0]


def test_closing_switches_off_even_where_that_fails_and_only_once(supply, source):
    source.set_current_A(1.0, timeout_s=2.0)
    supply.fail_at = "cut"
    with pytest.raises(DeviceFault, match="cut must work"):
        source.close()
    assert supply.is_closed
    n_commands = len(supply.history)
    source.close()
    assert len(supply.history) == n_commands


@given(st.floats(-20, 0), st.floats(0, 20), st.floats(0.1, 100))
def test_the_time_to_switch_off_is_enough_for_a_ramp_from_the_largest_current(
    lowest_A, highest_A, slew_A_per_s
):
    supply = MemorySupply()
    supply.lowest_A, supply.highest_A = lowest_A, highest_A
    source = RampedSource(supply, slew_A_per_s=slew_A_per_s)
    largest_A = max(-lowest_A, highest_A)
    n_steps = len(ramp_steps(largest_A, 0.0, slew_A_per_s, supply.step_s))
    assert source.longest_off_s >= 1.5 * n_steps * supply.step_s
    assert source.longest_off_s == longest_off_s(largest_A, slew_A_per_s)


def test_a_supply_that_was_only_looked_at_is_left_as_it_was_found(supply):
    supply.is_on, supply.set_point_A = True, 2.0
    with RampedSource(supply, slew_A_per_s=20.0) as source:
        source.identify(timeout_s=1.0)
        assert source.read_current_A(timeout_s=1.0).value == 2.0
    assert (supply.is_on, supply.set_point_A, supply.is_closed) == (True, 2.0, True)


def test_closing_allows_the_time_to_switch_off(supply):
    source = RampedSource(supply, slew_A_per_s=0.1)
    source.set_current_A(0.0, timeout_s=1.0)
    allowed_s = []
    source.output_off = lambda *, timeout_s: allowed_s.append(timeout_s)
    source.close()
    assert allowed_s == [longest_off_s(5.0, 0.1)]


def test_switching_off_from_another_thread_ends_a_ramp_between_two_steps(supply):
    source = RampedSource(supply, slew_A_per_s=5.0)
    source.set_current_A(0.0, timeout_s=1.0)
    errors = []

    def ramp():
        try:
            source.set_current_A(5.0, timeout_s=5.0)
        except DeviceFault as error:
            errors.append(str(error))

    thread = threading.Thread(target=ramp)
    thread.start()
    while supply.set_point_A < 1.0:
        time.sleep(0.01)
    source.output_off(timeout_s=5.0)
    thread.join()
    assert "interrupted" in errors[0]
    written_A = supply.written_A
    peak = written_A.index(max(written_A))
    assert written_A[peak:] == sorted(written_A[peak:], reverse=True)
    assert not supply.is_on


def test_a_slew_rate_must_be_positive(supply):
    with pytest.raises(Refused, match="slew_A_per_s must be > 0; received 0"):
        RampedSource(supply, slew_A_per_s=0.0)


class Renewed:
    """Opens supplies in memory, one after the other; `None` stands for one that is not there."""

    def __init__(self, *supplies):
        self.supplies = list(supplies)

    def __call__(self):
        supply = self.supplies.pop(0)
        if supply is None:
            raise DeviceFault("supply must accept a connection")
        return supply


def test_a_supply_whose_connection_is_lost_is_switched_off_on_a_new_one(supply):
    fresh = MemorySupply()
    source = RampedSource(supply, slew_A_per_s=20.0, reopen=Renewed(None, fresh))
    source.set_current_A(1.0, timeout_s=2.0)
    supply.fail_at, fresh.is_on = "cut", True
    source.output_off(timeout_s=5.0)
    assert supply.is_closed
    assert fresh.history == [("cut",), ("is_on",)]
    assert not fresh.is_on


def test_a_supply_that_never_confirms_is_told_on_a_new_connection_too(supply, monkeypatch):
    monkeypatch.setattr(ramped, "_PAUSE_S", 0.01)

    def hear_nothing(_):
        raise DeadlineExceeded("nothing received")

    fresh = MemorySupply()
    source = RampedSource(supply, slew_A_per_s=20.0, reopen=Renewed(fresh))
    source.set_current_A(1.0, timeout_s=2.0)
    supply.history.clear()
    supply.is_output_on = hear_nothing
    source.output_off(timeout_s=5.0)
    assert supply.history.count(("cut",)) >= 3
    assert fresh.history == [("cut",), ("is_on",)]


def test_a_thread_that_waits_for_a_mute_supply_does_not_keep_another_from_switching_it_off(supply):
    source = RampedSource(supply, slew_A_per_s=20.0)
    source.set_current_A(1.0, timeout_s=2.0)
    is_over = threading.Event()

    def wait_for_an_answer(_):
        is_over.wait(10.0)
        raise DeadlineExceeded("nothing received")

    supply.read_set_point_A = wait_for_an_answer

    def ramp():
        with contextlib.suppress(DriverError):
            source.set_current_A(2.0, timeout_s=9.0)

    thread = threading.Thread(target=ramp)
    thread.start()
    time.sleep(0.1)
    source.output_off(timeout_s=8.0)
    assert not supply.is_on
    is_over.set()
    thread.join()
