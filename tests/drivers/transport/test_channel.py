"""A channel asks one question at a time, keeps its deadlines, and never takes an answer for the answer to another question."""

from __future__ import annotations

import re
import threading
import time

import pytest

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.transport.channel import Channel, Landmark
from tests.drivers.replay import ScriptedPort


def ask(channel, timeout_s=0.3):
    deadline = Deadline.after(timeout_s)
    with channel.exchange(deadline):
        return channel.query(b"?\n", b"\r\n", deadline)


def test_an_answer_may_come_in_pieces_even_within_its_end():
    assert ask(Channel(ScriptedPort([(0, b"1."), (0.01, b"5\r"), (0.02, b"\n")]))) == b"1.5"


def test_what_came_before_the_question_is_no_answer():
    port = ScriptedPort([(0, b"new\r\n")])
    port.due = [(0, b"old\r\n")]
    assert ask(Channel(port)) == b"new"


def test_a_late_answer_is_not_taken_for_that_of_the_next_question():
    channel = Channel(ScriptedPort([(0.25, b"first\r\n")], [(0, b"second\r\n")]))
    with pytest.raises(DeadlineExceeded):
        ask(channel, 0.2)
    assert ask(channel) == b"second"


def test_an_answer_that_is_later_than_any_silence_is_told_from_that_of_the_next_question():
    port = ScriptedPort([(0.6, b"first\r\n")], [(0.7, b"I am it\r\n")], [(0, b"second\r\n")])
    channel = Channel(port, find_step=Landmark(b"who?\n", b"\r\n", re.compile(b"I am .*")).find)
    with pytest.raises(DeadlineExceeded):
        ask(channel, 0.1)
    assert ask(channel, 10.0) == b"second"
    assert port.sent == b"?\nwho?\n?\n"


def test_a_deadline_is_kept_and_says_what_came():
    begin_s = time.monotonic()
    with pytest.raises(
        DeadlineExceeded, match=r"must end with b'\\r\\n' within 0.2 s; received b'1.5' \(scripted\)"
    ):
        ask(Channel(ScriptedPort([(0, b"1.5")])), 0.2)
    assert 0.19 < time.monotonic() - begin_s < 0.4


def test_a_device_that_never_falls_silent_misses_the_deadline_too():
    class Talking(ScriptedPort):
        def receive(self, deadline):
            return b"x" * 100

    begin_s = time.monotonic()
    with pytest.raises(DeadlineExceeded, match="must fall silent"):
        ask(Channel(Talking()), 0.2)
    assert time.monotonic() - begin_s < 0.5


def test_an_answer_without_end_is_a_fault_before_it_fills_the_memory():
    with pytest.raises(DeviceFault, match="bytes came without it"):
        ask(Channel(ScriptedPort([(0, b"x" * 2_000_000)])))


def test_a_second_thread_waits_for_its_turn_and_no_longer_than_it_may():
    channel = Channel(ScriptedPort())
    is_inside, may_leave = threading.Event(), threading.Event()

    def hold():
        with channel.exchange(Deadline.after(1.0)):
            is_inside.set()
            may_leave.wait(5.0)

    thread = threading.Thread(target=hold)
    thread.start()
    is_inside.wait(1.0)
    with pytest.raises(DeadlineExceeded, match="a call of another thread goes on"):
        ask(channel, 0.1)
    may_leave.set()
    thread.join()


def test_a_stream_is_ended_before_the_next_question_after_a_fault():
    port = ScriptedPort([], [], [(0, b"ok\r\n")])
    channel = Channel(port, quieten=b"S")
    with pytest.raises(DeadlineExceeded):
        ask(channel, 0.1)
    assert ask(channel) == b"ok"
    assert port.sent == b"?\nS?\n"


def test_errors_name_the_port_once_and_count_as_faults():
    channel = Channel(ScriptedPort())
    with pytest.raises(DeviceFault, match=r"^no number \(scripted\)$"), channel.exchange(Deadline.after(1.0)):
        raise DeviceFault("no number")
    assert channel.n_faults == 1


def test_a_closed_channel_refuses_and_closing_twice_does_nothing():
    port = ScriptedPort()
    channel = Channel(port)
    channel.close()
    channel.close()
    assert port.is_closed
    with pytest.raises(DeviceFault, match="it was closed"):
        ask(channel)
