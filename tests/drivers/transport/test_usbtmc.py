"""The port of the kernel's USBTMC driver; a pseudo-terminal stands for its file, and a function for its timeout."""

from __future__ import annotations

import os
import select
import struct
import tty

import pytest

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.transport import usbtmc
from drivers.transport.usbtmc import UsbtmcPort


@pytest.fixture
def line(monkeypatch):
    """The port, the instrument's end, and the timeouts that the kernel was told."""
    master, slave = os.openpty()
    tty.setraw(slave)
    timeouts_ms = []
    read = os.read

    def read_as_the_kernel(file, n_bytes):
        if not select.select([file], [], [], timeouts_ms[-1] / 1e3)[0]:
            raise TimeoutError
        return read(file, n_bytes)

    monkeypatch.setattr(
        usbtmc.fcntl, "ioctl", lambda _, code, data: timeouts_ms.append(struct.unpack("I", data)[0]) or code
    )
    port = UsbtmcPort(os.ttyname(slave))
    monkeypatch.setattr(usbtmc.os, "read", read_as_the_kernel)
    yield port, master, timeouts_ms
    monkeypatch.undo()
    port.close()
    os.close(slave)
    os.close(master)


def soon():
    return Deadline.after(0.5)


def test_a_question_is_answered_and_the_kernel_told_the_deadline(line):
    port, master, timeouts_ms = line
    port.send(b"*IDN?\n", soon())
    os.write(master, b"Metrolab\n")
    assert port.receive(soon()) == b"Metrolab\n"
    assert all(400 <= timeout_ms <= 500 for timeout_ms in timeouts_ms)


def test_nothing_is_read_where_nothing_was_asked(line):
    port, _, timeouts_ms = line
    port.send(b":ABOR\n", soon())
    n_calls = len(timeouts_ms)
    with pytest.raises(DeadlineExceeded, match="nothing was asked"):
        port.receive(soon())
    assert len(timeouts_ms) == n_calls


def test_nothing_more_is_read_after_the_end_of_an_answer(line):
    port, master, _ = line
    port.send(b"a?\n", soon())
    os.write(master, b"1\n")
    port.receive(soon())
    with pytest.raises(DeadlineExceeded, match="nothing was asked"):
        port.receive(soon())


def test_silence_ends_at_the_deadline(line):
    port, _, _ = line
    port.send(b"a?\n", soon())
    with pytest.raises(DeadlineExceeded, match="nothing came"):
        port.receive(Deadline.after(0.1))


def test_a_device_that_is_not_there_is_a_fault():
    with pytest.raises(DeviceFault, match="must open as a USBTMC device"):
        UsbtmcPort("/dev/no_such_usbtmc")


def test_a_closed_port_is_a_fault(line):
    port, _, _ = line
    port.close()
    port.close()
    with pytest.raises(DeviceFault, match="it was closed"):
        port.send(b"a?\n", soon())
