"""A pumped port keeps all bytes with their arrival times, and returns them before it raises an error."""

from __future__ import annotations

import socket
import time

import pytest

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.transport import pumped
from drivers.transport.pumped import PumpedPort
from drivers.transport.tcp import TcpPort


@pytest.fixture
def line():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = PumpedPort(TcpPort("127.0.0.1", server.getsockname()[1], timeout_s=1.0))
        connection, _ = server.accept()
        with connection:
            yield port, connection
        port.close()


def soon():
    return Deadline.after(1.0)


def test_what_arrived_long_ago_keeps_its_time(line):
    port, connection = line
    connection.sendall(b"first")
    sent_s = time.monotonic()
    time.sleep(0.3)
    connection.sendall(b"second")
    time.sleep(0.1)
    assert port.receive(soon()) == b"first"
    assert port.arrived_s - sent_s < 0.1
    assert port.receive(soon()) == b"second"
    assert 0.2 < port.arrived_s - sent_s < 0.4


def test_more_than_any_buffer_of_the_system_is_kept(line):
    port, connection = line
    connection.settimeout(5.0)
    connection.sendall(bytes(20_000_000))  # blocks where nobody empties the line
    n_bytes = 0
    while n_bytes < 20_000_000:
        n_bytes += len(port.receive(soon()))


def test_silence_ends_at_the_deadline(line):
    port, _ = line
    with pytest.raises(DeadlineExceeded):
        port.receive(Deadline.after(0.05))


def test_a_loss_is_told_after_what_came_before_it(line):
    port, connection = line
    connection.sendall(b"last words")
    connection.close()
    assert port.receive(soon()) == b"last words"
    with pytest.raises(DeviceFault, match="the other side closed it"):
        port.receive(soon())


def test_a_port_that_nobody_reads_gives_up_before_the_memory_is_full(line, monkeypatch):
    monkeypatch.setattr(pumped, "_MOST_BYTES", 1000)
    port, connection = line
    connection.sendall(bytes(2000))
    with pytest.raises(DeviceFault, match="must be read; 2000 bytes are waiting"):  # noqa: PT012
        for _ in range(5):
            port.receive(soon())


def test_an_error_that_nobody_expected_is_told_and_does_not_end_in_silence():
    class Broken:
        name, arrived_s = "broken", 0.0

        def receive(self, deadline):
            raise OSError("no space left")

        def close(self):
            pass

    port = PumpedPort(Broken())
    with pytest.raises(DeviceFault, match="broken must be read; no space left"):
        port.receive(Deadline.after(10.0))
    port.close()
