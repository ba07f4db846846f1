"""A child process serves one call at a time, drops late calls, and brings its device to rest when its parent is gone."""

from __future__ import annotations

import os
import signal
import threading
import time
from functools import partial

import pytest

from drivers.children import start_without_main
from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.supervised import Supervised


class Device:
    """Notes each call in a file that the test reads."""

    def __init__(self, path, interrupt):
        self.path, self.interrupt = path, interrupt
        self.note("made")

    def note(self, text):
        with self.path.open("a") as file:
            file.write(f"{text}\n")

    def work(self, *, duration_s, timeout_s):
        self.note("work")
        if self.interrupt.wait(duration_s):
            raise DeviceFault("interrupted")
        return duration_s

    def be_stubborn(self, *, timeout_s):
        self.note("stubborn")
        time.sleep(1.0)

    def rest(self, *, timeout_s):
        assert not self.interrupt.is_set()
        self.note("rest")

    def fail(self, *, timeout_s):
        raise ZeroDivisionError("of its own")

    def close(self):
        self.note("close")


class NeedyDevice(Device):
    """A device that must be kept alive."""

    is_lost = False

    def keep_alive(self):
        self.note("alive")

    def lose(self, *, timeout_s):
        self.is_lost = True


@pytest.fixture
def path(tmp_path):
    return tmp_path / "notes.txt"


def supervise(kind, path):
    return Supervised(partial(kind, path), "device", longest_start_s=60.0)


def test_calls_return_raise_and_end_with_close(path):
    supervised = supervise(Device, path)
    assert supervised.call("work", duration_s=0.01, timeout_s=1.0) == 0.01
    with pytest.raises(DeviceFault, match="ZeroDivisionError: of its own"):
        supervised.call("fail", timeout_s=1.0)
    supervised.close(timeout_s=2.0)
    supervised.close(timeout_s=2.0)
    assert path.read_text().split() == ["made", "work", "close"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_what_ends_a_program_in_a_terminal_never_ends_a_child(path, monkeypatch, number):
    """Not even one that only starts, to switch off what another has left on."""

    def start(process):
        start_without_main(process)
        os.kill(process.pid, number)

    monkeypatch.setattr("drivers.supervised.start_without_main", start)
    supervised = supervise(Device, path)
    os.kill(supervised.pid, number)
    assert supervised.call("work", duration_s=0.01, timeout_s=1.0) == 0.01
    supervised.close(timeout_s=2.0)
    assert path.read_text().split() == ["made", "work", "close"]


def test_an_urgent_call_ends_the_one_that_goes_on(path):
    supervised = supervise(Device, path)
    errors = []

    def work():
        try:
            supervised.call("work", duration_s=20.0, timeout_s=30.0)
        except DeviceFault as error:
            errors.append(str(error))

    thread = threading.Thread(target=work)
    thread.start()
    time.sleep(0.3)
    begin_s = time.monotonic()
    supervised.call("rest", timeout_s=5.0, is_urgent=True)
    assert time.monotonic() - begin_s < 1.0
    thread.join()
    assert errors == ["interrupted"]
    supervised.close(timeout_s=2.0)


def test_an_interruption_that_was_given_up_does_not_hit_the_next_call(path):
    supervised = supervise(Device, path)
    thread = threading.Thread(target=supervised.call, args=("be_stubborn",), kwargs={"timeout_s": 30.0})
    thread.start()
    while "stubborn" not in path.read_text():
        time.sleep(0.01)
    with pytest.raises(DeadlineExceeded, match="must be free"):
        supervised.call("rest", timeout_s=0.1, is_urgent=True)
    thread.join()
    assert supervised.call("work", duration_s=0.01, timeout_s=30.0) == 0.01
    supervised.close(timeout_s=10.0)


def test_a_child_that_does_not_answer_can_be_killed(path):
    supervised = supervise(Device, path)
    os.kill(supervised.pid, signal.SIGSTOP)
    supervised.kill()
    assert supervised.has_ended
    assert path.read_text().split() == ["made"]


def test_a_call_whose_time_is_over_before_it_begins_is_not_carried_out(path):
    supervised = supervise(Device, path)
    with pytest.raises(DeadlineExceeded, match="nothing received"):
        supervised.call("work", duration_s=1.5, timeout_s=0.1)
    with pytest.raises(DeadlineExceeded):
        supervised.call("rest", timeout_s=0.1)
    assert supervised.call("work", duration_s=0.01, timeout_s=5.0) == 0.01  # and no answer of a call before
    supervised.close(timeout_s=2.0)
    assert path.read_text().split() == ["made", "work", "work", "close"]


def test_a_device_that_needs_it_is_kept_alive(path):
    supervised = supervise(NeedyDevice, path)
    time.sleep(0.5)
    supervised.close(timeout_s=2.0)
    assert path.read_text().count("alive") > 4


def test_a_lost_device_ends_its_process_without_another_word(path):
    supervised = supervise(NeedyDevice, path)
    supervised.call("lose", timeout_s=1.0)
    with pytest.raises(DeviceFault, match="its connection to the device broke"):
        supervised.call("rest", timeout_s=1.0)
    assert supervised.has_ended
    assert "close" not in path.read_text()
    with pytest.raises(DeviceFault):
        supervised.close(timeout_s=1.0)
