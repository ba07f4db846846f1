"""Heads of requests as raw bytes: what a proxy in front may read in another way is refused, and its connection ends."""

from __future__ import annotations

import logging
import re
import socket
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from estimator.service.app import create_app
from estimator.service.settings import Settings
from tests.estimator.service.conftest import listening, until

RIGS = b"POST /v1/rigs HTTP/1.1\r\nHost: 127.0.0.1\r\n"
HEALTH = b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"
HIDDEN = b"GET /readyz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Of a service in this process, behind uvicorn as `coilcal serve` has it."""
    settings = Settings(data=tmp_path_factory.mktemp("heads") / "data")
    with listening(create_app(settings, has_workers=False), settings) as port:
        yield port


def answers(port: int, said: bytes) -> bytes:
    """All that comes until the service closes the connection."""
    received = b""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line, suppress(ConnectionError):
        line.sendall(said)  # what is too long is not read to its end
        while piece := line.recv(65536):
            received += piece
    return received


@pytest.mark.parametrize(
    ("framing", "rule"),
    [
        (b"Content-Length: 40\r\nTransfer-Encoding: chunked\r\n", b"must not stand beside Content-Length"),
        (b"Transfer-Encoding: chunked\r\nContent-Length: 0\r\n", b"must not stand beside Content-Length"),
        (b"transfer-encoding:CHUNKED\r\nCONTENT-LENGTH:5\r\n", b"must not stand beside Content-Length"),
    ],
)
def test_a_body_with_two_ends_is_refused_and_nothing_after_it_is_read(port, framing, rule):
    """A proxy that goes by the length takes for a body what this service would take for a second request."""
    answer = answers(port, RIGS + framing + b"\r\n0\r\n\r\n" + HIDDEN)
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert rule in answer
    assert b"connection: close" in answer.lower()
    assert answer.count(b"HTTP/1.1 ") == 1


def test_a_chunked_body_in_http_1_0_is_refused(port):
    said = RIGS.replace(b"HTTP/1.1", b"HTTP/1.0") + b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n"
    answer = answers(port, said + HIDDEN)
    assert b" 400 " in answer.splitlines()[0]
    assert b"must not be given in HTTP/1.0" in answer
    assert answer.count(b"HTTP/1.1 ") == 1


def test_a_chunked_body_alone_is_read_and_the_next_request_answered(port):
    said = RIGS + b"Content-Type: application/yaml\r\nTransfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n\r\n"
    answer = answers(port, said + HEALTH)
    assert answer.startswith(b"HTTP/1.1 422 ")
    assert answer.count(b"HTTP/1.1 200 ") == 1


HEADS = {
    "a long header": b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX: " + b"a" * 200_000 + b"\r\n\r\n",
    "many headers": b"GET /healthz HTTP/1.1\r\n" + b"".join(b"X-%d: a\r\n" % n for n in range(20_000)) + b"\r\n",
    "a negative length": RIGS + b"Content-Length: -1\r\n\r\n",
    "a signed length": RIGS + b"Content-Length: +2\r\n\r\n{}",
    "two lengths": RIGS + b"Content-Length: 2\r\nContent-Length: 3\r\n\r\n{}",
    "two lengths in one": RIGS + b"Content-Length: 2, 3\r\n\r\n{}",
    "two encodings": RIGS + b"Transfer-Encoding: chunked\r\nTransfer-Encoding: identity\r\n\r\n0\r\n\r\n",
    "another encoding": RIGS + b"Transfer-Encoding: xchunked\r\n\r\n0\r\n\r\n",
    "an encoding with a tab": RIGS + b"Transfer-Encoding : chunked\r\n\r\n0\r\n\r\n",
    "a chunk that is longer than it says": RIGS
    + b"Content-Type: application/yaml\r\nTransfer-Encoding: chunked\r\n\r\n2\r\n{}XY0\r\n\r\n",
    "a carriage return in a chunk's extension": RIGS
    + b"Content-Type: application/yaml\r\nTransfer-Encoding: chunked\r\n\r\n2;a\rb\r\n{}\r\n0\r\n\r\n",
    "two hosts": b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: b\r\n\r\n",
    "no host": b"GET /healthz HTTP/1.1\r\n\r\n",
    "a zero in a header": b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX: a\0b\r\n\r\n",
    "line feeds alone": b"GET /healthz HTTP/1.1\nHost: 127.0.0.1\n\n",
    "one line feed alone": b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\nX: a\r\n\r\n",
    "a line feed alone at the end": b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\n",
    "a line feed first": b"\nGET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    "a fold": b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX: a\r\n b\r\n\r\n",
    "a fold with a tab": b"GET /healthz HTTP/1.1\r\nX: a\r\n\tb\r\nHost: 127.0.0.1\r\n\r\n",
    "a folded length": RIGS + b"Content-Length:\r\n 2\r\n\r\n{}",
    "a carriage return alone": b"GET /healthz HTTP/1.1\rHost: 127.0.0.1\r\n\r\n",
    "TLS": b"\x16\x03\x01\x02\x00\x01\x00\x01\r\n\r\n",
}  # fmt: skip


@pytest.mark.parametrize("said", HEADS.values(), ids=HEADS)
def test_heads_that_are_none_are_answered_with_400_or_closed(port, said):
    answer = answers(port, said)
    assert not answer or answer.split(b" ")[1] in (b"400", b"431", b"501"), answer[:200]
    assert b" 200 " in answers(port, HEALTH).splitlines()[0]


LOOSE = [name for name in HEADS if "line feed" in name or "fold" in name]


@pytest.mark.parametrize("pieces", [1, 7, 1000])
@pytest.mark.parametrize("name", LOOSE)
def test_loose_lines_are_refused_however_they_arrive_and_nothing_after_them_is_read(port, name, pieces):
    said = HEADS[name] + HIDDEN
    size = -(-len(said) // pieces)
    received = b""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line, suppress(ConnectionError):
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for i in range(0, len(said), size):
            line.sendall(said[i : i + size])
            time.sleep(0.0005)
        while piece := line.recv(65536):
            received += piece
    assert b" 200 " not in received
    assert received.count(b"HTTP/1.1 ") <= 1
    assert not received or received.startswith(b"HTTP/1.1 400 ")


@pytest.mark.parametrize("trailer", [b"X: a\n\r\n", b"X: a\r\n b\r\n\r\n", b"X: a\n\n"])
def test_loose_lines_in_a_trailer_are_refused(port, trailer):
    said = RIGS + b"Content-Type: application/yaml\r\nTransfer-Encoding: chunked\r\n\r\n2\r\n{}\r\n0\r\n"
    assert b" 422 " in answers(port, said + b"X: a\r\n\r\n" + HEALTH)
    assert b" 200 " not in answers(port, said + trailer + HEALTH)


def test_requests_that_follow_each_other_at_once_are_all_strict(port):
    first = HEALTH.replace(b"Connection: close\r\n", b"")
    answer = answers(port, first + first + HEALTH)
    assert answer.count(b"HTTP/1.1 200 ") == 3
    answer = answers(port, first + HEADS["one line feed alone"] + HEALTH)
    assert re.findall(rb"HTTP/1\.1 (\d+)", answer) == [b"200", b"400"]


@pytest.mark.parametrize(
    "host", [b"[", b"[::1", b"a]b[", b"", b"evil.example", b"a@127.0.0.1", b"127.0.0.1:a", b"\xff"]
)
def test_a_host_that_is_none_is_refused_in_words(port, host):
    answer = answers(port, b"GET /v1/state HTTP/1.1\r\nHost: " + host + b"\r\nConnection: close\r\n\r\n")
    assert answer.startswith(b"HTTP/1.1 403 ")
    assert b"application/problem+json" in answer


@pytest.mark.parametrize("host", [b"127.0.0.1", b"LOCALHOST:8765", b"[::1]:1", b"127.0.0.1:"])
def test_names_of_this_computer_are_hosts_with_and_without_a_port(port, host):
    answer = answers(port, b"GET /v1/state HTTP/1.1\r\nHost: " + host + b"\r\nConnection: close\r\n\r\n")
    assert answer.startswith(b"HTTP/1.1 200 ")


def test_a_client_that_leaves_in_its_body_is_no_fault_of_the_service(port, caplog):
    caplog.set_level(logging.INFO)
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line:
        line.sendall(RIGS + b"Content-Type: application/yaml\r\nContent-Length: 100\r\n\r\n{")
    until(lambda: any(record.message == "request" for record in caplog.records))
    assert [record.message for record in caplog.records if record.levelname == "ERROR"] == []
    assert any(getattr(record, "status", None) == 400 for record in caplog.records)
