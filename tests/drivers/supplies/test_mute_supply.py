"""A supply that obeys and no longer answers is told zero and then off before anything is read, on a new connection too."""

from __future__ import annotations

import itertools
import re
import threading
import time

import pytest

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded
from drivers.supplies.korad_ka3005p import KoradKA3005P
from drivers.supplies.ramped import RampedSource
from drivers.supplies.scpi import GENERIC, KEPCO_BOP, ScpiSupply

OK = '0,"No error"'


class ObedientPort:
    """Plays a supply that obeys always, and answers as long as it is not mute; `history` holds lines and readings in their order."""

    name = "/dev/fake"
    arrived_s = 0.0

    def __init__(self, answer):
        self.answer, self.is_mute = answer, False
        self.history, self.out = [], b""
        self.is_on, self.current_A = False, 0.0

    def send(self, data, deadline):
        line = data.decode().strip()
        self.history.append(line)
        if match := re.match(r"(?:CURR |ISET1:)([-\d.e+]+)", line):
            self.current_A = float(match[1])
        if match := re.match(r"OUTP (ON|OFF)|OUT([01])", line):
            self.is_on = match[1] == "ON" or match[2] == "1"
        if not self.is_mute:
            self.out += self.answer(self, line)

    def receive(self, deadline):
        self.history.append("read")
        if not self.out:
            deadline.sleep_out()
            raise DeadlineExceeded("nothing came")
        data, self.out = self.out, b""
        return data

    def close(self):
        pass


def scpi_answer(port, line):
    answers = {
        "*IDN?": "KEPCO,BOP 50-20",
        "CURR?": f"{port.current_A:+.6E};{OK}",
        "OUTP?": f"{int(port.is_on)};{OK}",
    }
    return f"{answers.get(line.split(';')[0], OK)}\n".encode() if "?" in line else b""


def korad_answer(port, line):
    answers = {
        "*IDN?": b"KORADKA3005PV2.0",
        "VSET1?": b"20.00",
        "ISET1?": f"{port.current_A:05.3f}".encode(),
        "STATUS?": bytes([0x40 * port.is_on]),
    }
    return answers.get(line, b"")


def scpi_supply(dialect):
    return lambda port: ScpiSupply(
        port, dialect=dialect, lowest_A=-5.0, highest_A=5.0, compliance_V=20.0, resolution_A=5e-3
    )


KINDS = {
    "kepco": (scpi_answer, scpi_supply(KEPCO_BOP), ["SYST:REM 1", "CURR 0", "OUTP OFF", "*CLS"]),
    "scpi": (scpi_answer, scpi_supply(GENERIC), ["CURR 0", "OUTP OFF", "*CLS"]),
    "korad": (korad_answer, lambda port: KoradKA3005P(port, compliance_V=20.0), ["ISET1:0.000", "OUT0"]),
}


@pytest.fixture(params=KINDS)
def kind(request):
    return KINDS[request.param]


def before_reading(history):
    return list(itertools.takewhile(lambda line: line != "read", history))


def test_a_supply_that_falls_mute_is_told_zero_and_off_before_anything_is_read_and_again_and_again(kind):
    answer, make, cut = kind
    port = ObedientPort(answer)
    source = RampedSource(make(port), slew_A_per_s=20.0)
    source.set_current_A(3.0, timeout_s=10.0)
    assert (port.is_on, port.current_A) == (True, 3.0)
    port.is_mute = True
    port.history.clear()
    begin_s = time.monotonic()
    with pytest.raises(DeadlineExceeded):
        source.output_off(timeout_s=4.0)
    assert time.monotonic() - begin_s < 6.5
    assert before_reading(port.history)[-len(cut) :] == cut
    assert port.history.count(cut[-1]) >= 2
    assert (port.is_on, port.current_A) == (False, 0.0)


def test_a_supply_that_is_mute_from_the_first_moment_of_a_connection_is_told_too(kind):
    answer, make, cut = kind
    port = ObedientPort(answer)
    port.is_mute, port.is_on, port.current_A = True, True, 3.0
    source = RampedSource(make(port), slew_A_per_s=20.0)
    with pytest.raises(DeadlineExceeded):
        source.output_off(timeout_s=0.5)
    assert before_reading(port.history) == cut
    assert (port.is_on, port.current_A) == (False, 0.0)


def test_a_supply_that_answers_again_is_told_no_more(kind):
    answer, make, cut = kind
    port = ObedientPort(answer)
    source = RampedSource(make(port), slew_A_per_s=20.0)
    source.set_current_A(3.0, timeout_s=10.0)
    port.is_mute = True
    with pytest.raises(DeadlineExceeded):
        source.read_current_A(timeout_s=0.2)
    port.history.clear()
    port.is_mute = False
    source.output_off(timeout_s=10.0)
    assert port.history.count(cut[-1]) == 1
    assert (port.is_on, port.current_A) == (False, 0.0)


def test_a_port_that_another_thread_holds_takes_the_command_nevertheless(kind):
    answer, make, cut = kind
    port = ObedientPort(answer)
    port.is_on = True
    supply = make(port)
    is_held, is_over = threading.Event(), threading.Event()

    def hold():
        with supply._channel.exchange(Deadline.after(10.0)):
            is_held.set()
            is_over.wait(10.0)

    thread = threading.Thread(target=hold)
    thread.start()
    is_held.wait(10.0)
    supply.cut(Deadline.after(5.0))
    assert port.history == cut
    assert not port.is_on
    is_over.set()
    thread.join()
