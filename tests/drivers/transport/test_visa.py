"""The VISA port over pyvisa-py and pyusb, on a fake USB bus; the test answers as the instrument through a pseudo-terminal."""

from __future__ import annotations

import logging
import os
import sys
import threading
import time
import tty
from concurrent.futures import ThreadPoolExecutor

import pytest

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault, Refused
from drivers.on_channel import identity_landmark
from drivers.transport.channel import Channel
from drivers.transport.visa import VisaPort
from tests.drivers.transport.fake_usb import CHECK_ABORT_BULK_IN_STATUS, FakeInstrument, open_on_bus

LATE_S = 0.2
"""Time that a call may take beyond its deadline."""


class Bench:
    """An instrument on the bus, the pseudo-terminal through which the test answers for it, and a port to it."""

    def __init__(self, packet_bytes=64):
        self.end, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.instrument = FakeInstrument(os.ttyname(self._slave), packet_bytes)
        self.port = self.instrument.open()

    def say(self, answer, after_s=0.0):
        """Answer as the instrument, after a delay."""
        timer = threading.Timer(after_s, os.write, (self.end, answer))
        timer.start() if after_s else timer.function(*timer.args)
        return timer

    def heard(self, n_bytes=1):
        arrived = b""
        while len(arrived) < n_bytes:
            arrived += os.read(self.end, 65536)
        return arrived

    def close(self):
        self.instrument.hangs_at_abort = False
        self.instrument.fault = "unplugged"  # ends the work of the port's thread at once
        self.port.close()
        os.close(self._slave)
        os.close(self.end)


@pytest.fixture
def bench(request):
    bench = Bench(*getattr(request, "param", ()))
    yield bench
    bench.close()


def soon(timeout_s=1.0):
    return Deadline.after(timeout_s)


def missed_s(call, *arguments, timeout_s):
    """Duration of a call that misses its deadline."""
    begin_s = time.monotonic()
    with pytest.raises(DeadlineExceeded, match=f"within {timeout_s:g} s"):
        call(*arguments, Deadline.after(timeout_s))
    return time.monotonic() - begin_s


packets = pytest.mark.parametrize("bench", [(64,), (512,)], indirect=True, ids=["full speed", "high speed"])


@packets
@pytest.mark.parametrize("n_bytes", [1, 2, 3, 4, 51, 52, 53, 64, 500, 512, 20480, 40000])
def test_messages_of_every_length_pass_both_ways(bench, n_bytes):
    message = b"x" * (n_bytes - 1) + b"\n"
    with ThreadPoolExecutor(1) as thread:  # a terminal holds less than the longest
        heard = thread.submit(bench.heard, n_bytes + 2)
        bench.port.send(b"?\n" + message, soon())
        assert heard.result(1.0) == b"?\n" + message
        begin_s = time.monotonic()
        thread.submit(bench.say, message)
        assert bench.port.receive(soon()) == message
    assert begin_s < bench.port.arrived_s <= time.monotonic()


@packets
@pytest.mark.parametrize("most_bytes", [1, 48, 53, 200])
def test_an_answer_in_several_transfers_is_put_together(bench, most_bytes):
    """Not with 52 bytes at full speed: pyvisa-py waits for more if a transfer fills its last packet and does not end the message."""
    bench.instrument.most_bytes = most_bytes
    answer = bytes(range(11, 256)) + b"\n"
    bench.port.send(b"a?\n", soon())
    bench.say(answer)
    assert bench.port.receive(soon()) == answer


def test_an_answer_longer_than_is_asked_for_at_once_comes_in_pieces(bench, monkeypatch):
    monkeypatch.setattr("drivers.transport.visa._LONGEST_MESSAGE", 100)
    bench.port.send(b"a?\n", soon())
    bench.say(b"x" * 150 + b"\n")
    assert [bench.port.receive(soon()) for _ in range(2)] == [b"x" * 100, b"x" * 50 + b"\n"]


def test_nothing_is_read_where_nothing_was_asked(bench):
    bench.say(b"unasked\n")
    bench.port.send(b":ABOR\n", soon())
    assert missed_s(bench.port.receive, timeout_s=0.5) < LATE_S
    bench.port.send(b"a?\n", soon())
    bench.say(b"1\n")
    assert bench.port.receive(soon()) == b"1\n"
    with pytest.raises(DeadlineExceeded, match="nothing was asked"):
        bench.port.receive(soon())


def test_no_read_is_begun_where_there_is_no_time_to_wait(bench):
    bench.port.send(b"a?\n", soon())
    assert missed_s(bench.port.receive, timeout_s=0.0) < LATE_S
    bench.say(b"1\n")
    assert bench.port.receive(soon()) == b"1\n"


def test_a_mute_instrument_misses_the_deadline_and_answers_again(bench):
    bench.port.send(b"a?\n", soon())
    assert 0.3 <= missed_s(bench.port.receive, timeout_s=0.3) < 0.3 + LATE_S
    with pytest.raises(DeadlineExceeded, match="nothing was asked"):
        bench.port.receive(soon())
    bench.port.send(b"b?\n", soon())
    bench.say(b"2\n")
    assert bench.port.receive(soon()) == b"2\n"
    assert CHECK_ABORT_BULK_IN_STATUS in bench.instrument.log


def test_every_call_keeps_its_deadline_while_calling_off_a_transfer_hangs_for_seconds(bench):
    bench.instrument.hangs_at_abort = True
    bench.port.send(b"a?\n", soon())
    assert 0.3 <= missed_s(bench.port.receive, timeout_s=0.3) < 0.3 + LATE_S
    assert 0.5 <= missed_s(bench.port.send, b"b?\n", timeout_s=0.5) < 0.5 + LATE_S
    begin_s = time.monotonic()
    bench.port.send(b"c?\n", soon(10.0))  # as soon as pyvisa-py gives up
    assert 2.0 < time.monotonic() - begin_s < 5.0
    assert bench.heard(6) == b"a?\nc?\n"  # what was given up is not sent afterwards
    bench.say(b"3\n")
    assert bench.port.receive(soon()) == b"3\n"


def test_an_instrument_that_takes_nothing_misses_the_deadline(bench):
    bench.instrument.fault = "full"
    assert 0.2 <= missed_s(bench.port.send, b"a?\n", timeout_s=0.2) < 0.2 + LATE_S
    with pytest.raises(DeadlineExceeded, match="nothing was asked"):
        bench.port.receive(soon())


@pytest.mark.parametrize("forgets", [True, False], ids=["one answer at a time", "answers queue up"])
@pytest.mark.parametrize("after_s", [0.25, 0.5])
def test_a_late_answer_is_not_taken_for_that_of_another_question(bench, forgets, after_s):
    """The answer is late by less, and by more, than the silence that a channel waits for."""
    bench.instrument.forgets = forgets
    channel = Channel(bench.port, find_step=identity_landmark(b"\n", b"\n").find)
    deadline = soon(0.2)
    with pytest.raises(DeadlineExceeded), channel.exchange(deadline):
        channel.query(b"a?\n", b"\n", deadline)
    answers = {b"*IDN?\n": b"Metrolab,THM1176,1,2\n", b"b?\n": b"2\n"}
    writers = [bench.say(b"1\n", after_s)]
    assert bench.heard() == b"a?\n"

    def answer():
        for _ in answers:
            question = bench.heard()
            writers[0].join()  # in their order
            time.sleep(0.02)
            bench.say(answers[question])

    writers.append(threading.Thread(target=answer))
    writers[-1].start()
    deadline = soon(2.0)
    with channel.exchange(deadline):
        assert channel.query(b"b?\n", b"\n", deadline) == b"2"
    for writer in writers:
        writer.join()


def test_an_answer_that_comes_after_the_deadline_is_dropped(bench):
    bench.port.send(b"a?\n", soon())
    read = bench.instrument.give
    bench.instrument.give = lambda n_bytes, timeout_s: read(n_bytes, 1.0)  # beyond its timeout
    missed_s(bench.port.receive, timeout_s=0.1)
    bench.say(b"1\n")
    bench.port.send(b"b?\n", soon())
    bench.say(b"2\n")
    assert bench.port.receive(soon()) == b"2\n"


@pytest.mark.parametrize("call", ["send", "receive", "receive, waiting"])
def test_an_instrument_that_is_unplugged_is_a_fault(bench, call):
    if call != "send":
        bench.port.send(b"a?\n", soon())
    if call == "receive, waiting":
        threading.Timer(0.1, setattr, (bench.instrument, "fault", "unplugged")).start()
    else:
        bench.instrument.fault = "unplugged"
    with pytest.raises(DeviceFault, match="must stay connected; .*No such device"):
        bench.port.send(b"a?\n", soon()) if call == "send" else bench.port.receive(soon())


def test_an_endpoint_that_is_halted_is_a_fault(bench):
    bench.port.send(b"a?\n", soon())
    bench.instrument.fault = "stalled"
    with pytest.raises(DeviceFault, match="must stay connected; .*Pipe error"):
        bench.port.receive(soon())


@pytest.mark.filterwarnings("ignore:Unexpected MsgID:UserWarning")
@pytest.mark.parametrize("answer", [b"1.5\n", b"1;5\n"])
def test_an_answer_behind_a_header_of_noise_is_none(bench, answer):
    """pyvisa-py warns, takes the noise for a quirk of some firmware, and waits for the rest."""
    bench.instrument.fault = "garbled"
    bench.port.send(b"a?\n", soon())
    bench.say(answer)
    assert missed_s(bench.port.receive, timeout_s=0.3) < 0.3 + LATE_S


def test_a_closed_port_is_a_fault(bench):
    bench.port.close()
    bench.port.close()
    with pytest.raises(DeviceFault, match="must be open; it was closed"):
        bench.port.send(b"a?\n", soon())


def test_closing_waits_a_second_for_what_hangs_and_says_so(bench, caplog):
    bench.instrument.hangs_at_abort = True
    bench.port.send(b"a?\n", soon())
    missed_s(bench.port.receive, timeout_s=0.1)
    begin_s = time.monotonic()
    with caplog.at_level(logging.WARNING, "drivers.transport.visa"):
        bench.port.close()
    assert time.monotonic() - begin_s < 1.0 + LATE_S
    assert "is still busy" in caplog.text


def test_an_instrument_that_is_not_there_is_a_fault():
    with pytest.raises(
        DeviceFault, match="none::INSTR must be there, once, and be permitted; No device found"
    ):
        open_on_bus([], "USB0::0x1BFA::0x0498::none::INSTR")


def test_several_instruments_of_a_name_are_a_fault(bench):
    twins = [FakeInstrument(bench.instrument.serial_number) for _ in range(2)]
    try:
        with pytest.raises(DeviceFault, match=r"must be there, once, and be permitted; 2 devices found$"):
            open_on_bus(twins, bench.instrument.name)
    finally:
        for twin in twins:
            twin.release()


def test_no_usb_library_is_a_fault(monkeypatch):
    monkeypatch.setattr("usb.core.find", no_backend)
    monkeypatch.setattr("libusb_package.find", no_backend)
    with pytest.raises(DeviceFault, match="must be there, once, and be permitted; No backend available"):
        VisaPort("USB0::0x1BFA::0x0498::none::INSTR")


def no_backend(*_, **__):
    from usb.core import NoBackendError

    raise NoBackendError("No backend available")


def test_an_instrument_that_nobody_may_open_is_a_fault(bench):
    def refuse(_):
        raise OSError(13, "Access denied (insufficient permissions)")

    forbidden = FakeInstrument(bench.instrument.serial_number)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "tests.drivers.transport.fake_usb.FakeBus.open_device", lambda _, device: refuse(device)
        )
        with pytest.raises(DeviceFault, match="must be there, once, and be permitted"):
            forbidden.open()
    forbidden.release()


def test_what_opens_too_late_is_a_fault_in_time_and_is_let_go(bench):
    slow = FakeInstrument(bench.instrument.serial_number)
    slow.opens_after_s = 0.6
    begin_s = time.monotonic()
    with pytest.raises(DeviceFault, match="must open within 0.3 s; it does not") as caught:
        slow.open(timeout_s=0.3)
    assert time.monotonic() - begin_s < 0.3 + LATE_S
    assert slow.is_open
    time.sleep(0.6)
    assert not slow.is_open
    assert (
        caught.tb is not None
    )  # the traceback still holds the port, so no garbage collection has released it


@pytest.mark.parametrize("name", ["GPIB0::6::INSTR", "nonsense", "USB0::0x1BFA::0x0498::1::RAW"])
def test_what_cannot_be_reached_is_a_fault_in_one_sentence(name):
    with pytest.raises(DeviceFault, match=f"^{name} must be there, once, and be permitted; [^\n]+$"):
        VisaPort(name)


@pytest.mark.parametrize(
    "name", ["ASRL/dev/ttyUSB0::INSTR", "asrl1::instr", "TCPIP0::192.168.0.2::5025::SOCKET"]
)
def test_serial_lines_and_sockets_are_refused(name):
    with pytest.raises(Refused, match=rf"have the keys serial and tcp\); received {name}"):
        VisaPort(name)


@pytest.mark.parametrize("missing", ["pyvisa", "pyvisa_py"])
def test_it_says_what_to_install(monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(DeviceFault, match=r"pip install 'coilcal\[visa\]'"):
        VisaPort("GPIB0::6::INSTR")
