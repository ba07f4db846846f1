"""Serial ports, TCP and transcripts over the real stacks: bytes pass unchanged, and a lost connection is a fault that names the port."""

from __future__ import annotations

import os
import socket
import time
import tty
from pathlib import Path

import pytest

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.transport.serial_port import SerialPort, SerialSettings
from drivers.transport.tcp import TcpPort
from drivers.transport.transcript import Chunk, RecordingPort, ReplayedPort, decode, encode

ALL_BYTES = bytes(range(256))


@pytest.fixture
def serial_line():
    master, slave = os.openpty()
    tty.setraw(slave)
    port = SerialPort(os.ttyname(slave), SerialSettings(9600, has_rts_cts=True))
    yield port, master
    port.close()
    for end in (master, slave):
        try:
            os.close(end)
        except OSError:
            assert end == master


@pytest.fixture
def tcp_line():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = TcpPort("127.0.0.1", server.getsockname()[1], timeout_s=1.0)
        connection, _ = server.accept()
        with connection:
            yield port, connection
        port.close()


def soon():
    return Deadline.after(1.0)


def test_all_bytes_pass_a_serial_line_both_ways(serial_line):
    port, master = serial_line
    port.send(ALL_BYTES, soon())
    assert os.read(master, 1000) == ALL_BYTES
    os.write(master, ALL_BYTES)
    assert port.receive(soon()) == ALL_BYTES


def test_all_bytes_pass_tcp_both_ways(tcp_line):
    port, connection = tcp_line
    port.send(ALL_BYTES, soon())
    assert connection.recv(1000) == ALL_BYTES
    connection.sendall(ALL_BYTES)
    assert port.receive(soon()) == ALL_BYTES


@pytest.mark.parametrize("line", ["serial_line", "tcp_line"])
@pytest.mark.parametrize("timeout_s", [0.0, 0.1])
def test_silence_ends_at_the_deadline(line, timeout_s, request):
    port, _ = request.getfixturevalue(line)
    begin_s = time.monotonic()
    with pytest.raises(DeadlineExceeded, match="must receive within"):
        port.receive(Deadline.after(timeout_s))
    assert timeout_s <= time.monotonic() - begin_s < timeout_s + 0.1


def test_a_serial_line_that_is_pulled_is_a_fault(serial_line):
    port, master = serial_line
    os.close(master)
    with pytest.raises(DeviceFault, match=f"{port.name} must stay connected"):
        port.receive(soon())


def test_a_tcp_peer_that_leaves_is_a_fault(tcp_line):
    port, connection = tcp_line
    connection.close()
    with pytest.raises(DeviceFault, match="the other side closed it"):
        port.receive(soon())


def test_a_serial_port_has_one_owner(serial_line):
    port, _ = serial_line
    with pytest.raises(DeviceFault, match="must open as a serial port"):
        SerialPort(port.name, SerialSettings(9600))


def test_a_pseudo_terminal_opens_again_for_an_instrument_with_parity():
    master, slave = os.openpty()
    tty.setraw(slave)
    for _ in range(3):
        SerialPort(os.ttyname(slave), SerialSettings(9600, data_bits=7, parity="O")).close()
    os.close(slave)
    os.close(master)


def test_a_port_that_is_not_there_is_a_fault():
    with pytest.raises(DeviceFault, match="/dev/no_such_port must open"):
        SerialPort("/dev/no_such_port", SerialSettings(9600))
    with pytest.raises(DeviceFault, match="must accept a connection"):
        TcpPort("127.0.0.1", 1, timeout_s=1.0)


def test_a_replay_answers_as_recorded_and_refuses_other_questions():
    chunks = [
        Chunk(0.0, ">", b"a?"),
        Chunk(0.1, "<", b"1"),
        Chunk(0.2, "<", b"2"),
        Chunk(0.3, ">", b"b?"),
        Chunk(0.4, "<", b"3"),
    ]
    port = ReplayedPort(chunks, "recorded.txt")
    port.send(b"a?", soon())
    assert port.receive(soon()) + port.receive(soon()) == b"12"
    with pytest.raises(DeadlineExceeded, match="nothing is recorded here"):
        port.receive(soon())
    assert not port.is_over
    with pytest.raises(DeviceFault, match=r"must be sent b'b\?' next; received b'c\?'"):
        port.send(b"c?", soon())


def test_a_line_that_takes_nothing_is_given_the_time_allowed_and_no_more(serial_line):
    port, _ = serial_line
    begin_s = time.monotonic()
    with pytest.raises(
        DeadlineExceeded, match="must take what is sent within 1.5 s; its handshake says stop"
    ):
        port.send(bytes(10_000_000), Deadline.after(1.5))
    assert 1.4 < time.monotonic() - begin_s < 10.0


def test_what_is_recorded_can_be_replayed(tcp_line, tmp_path):
    port, connection = tcp_line
    path = tmp_path / "recorded.txt"
    recording = RecordingPort(port, path)
    recording.send(ALL_BYTES, soon())
    connection.sendall(b"'quoted\"\n")
    assert recording.receive(soon()) == b"'quoted\"\n"
    recording.close()
    replayed = ReplayedPort.from_file(path)
    replayed.send(ALL_BYTES, soon())
    assert replayed.receive(soon()) == b"'quoted\"\n"
    assert replayed.is_over


def test_a_recording_on_a_full_disk_ends_and_the_instrument_goes_on(tcp_line, caplog):
    port, connection = tcp_line
    recording = RecordingPort(port, Path("/dev/full"))
    for _ in range(2):
        recording.send(b"OUT0", soon())
        assert connection.recv(4) == b"OUT0"
    recording.close()
    assert caplog.text.count("the recording of") == 1


@pytest.mark.parametrize("line", ["0.1 > 'text'", "0.1 ? b'x'", "0.1 > b'x", "0.1 > b'x' + b'y'", "> b'x'"])
def test_a_line_that_is_none_of_a_transcript_is_told_with_its_number(line):
    with pytest.raises(DeviceFault, match=r"\(bad.txt, line 2\)"):
        decode(f"# a comment\n{line}\n", "bad.txt")


def test_a_transcript_survives_writing_and_reading():
    chunks = [Chunk(0.5, ">", ALL_BYTES), Chunk(1.25, "<", b"")]
    assert decode("\n".join(map(encode, chunks)), "x") == chunks


def test_a_transcript_that_is_not_there_is_a_fault(tmp_path):
    with pytest.raises(DeviceFault, match="must be readable as a transcript"):
        ReplayedPort.from_file(tmp_path / "none.txt")
