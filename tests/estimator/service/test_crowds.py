"""A client that says what it wants is answered at once beside any number of connections that do not."""

from __future__ import annotations

import resource
import select
import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import httpx
import pytest

from estimator.errors import InvalidInput
from estimator.service import connections, tls
from estimator.service.app import create_app
from estimator.service.connections import allow_files
from estimator.service.settings import Settings
from estimator.service.tls import http_of
from tests.estimator.service.conftest import listening

CROWD = 1300
SOON_S = 1.0
HEAD = b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX: "
BODY = b"POST /v1/login HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 99\r\n\r\n{"
SAID = {
    "nothing": b"",
    "half a head": HEAD,
    "a request, and nothing more": HEAD + b"a\r\n\r\n",
    "half a body": BODY,
    "half a body that is refused already": BODY.replace(b"/v1/login", b"/v1/rigs"),
}


@pytest.fixture(scope="module")
def port(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    allow_files()
    if resource.getrlimit(resource.RLIMIT_NOFILE)[0] < 2 * CROWD + 500:
        pytest.skip("this process may not open so many files")
    settings = Settings(data=tmp_path_factory.mktemp("crowd") / "data", require_tokens=True)
    with listening(create_app(settings, has_workers=False), settings) as port:
        yield port
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Files of a certificate of 127.0.0.1 and of its key."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    made = [str(tmp_path_factory.mktemp("tls") / name) for name in ("cert.pem", "key.pem")]
    call = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=coilcal -addext subjectAltName=IP:127.0.0.1"
    subprocess.run([*call.split(), "-out", made[0], "-keyout", made[1]], check=True, capture_output=True)
    return made[0], made[1]


@pytest.fixture(scope="module")
def tls_port(
    port: int,  # noqa: ARG001 - it allows files
    certificate: tuple[str, str],
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[int]:
    cert, key = certificate
    data = tmp_path_factory.mktemp("crowd") / "data"
    settings = Settings(data=data, require_tokens=True, tls_certificate=cert, tls_key=key)
    with listening(create_app(settings, has_workers=False), settings) as port_of_tls:
        yield port_of_tls


@contextmanager
def crowd(port: int, said: bytes, address: str) -> Iterator[list[socket.socket]]:
    with ExitStack() as stack:
        lines = []
        for _ in range(CROWD):
            line = socket.create_connection(("127.0.0.1", port), timeout=10, source_address=(address, 0))
            lines.append(stack.enter_context(line))
            line.sendall(said)
        yield lines


def took_s(client: httpx.Client) -> float:
    begin_s = time.monotonic()
    assert client.get("/healthz").status_code == 200
    return time.monotonic() - begin_s


@pytest.mark.flaky
@pytest.mark.parametrize(
    ("said", "address"), [*((said, "127.0.0.1") for said in SAID), ("half a body", "127.0.0.2")]
)
def test_a_client_is_answered_soon_beside_a_crowd(port, said, address):
    """From the crowd's own address too, as behind a proxy."""
    url = f"http://127.0.0.1:{port}"
    with crowd(port, SAID[said], address):
        with httpx.Client(base_url=url, timeout=30) as client:
            took_s(client)  # until the service has seen all of them
        times_s = []
        for _ in range(5):
            with httpx.Client(base_url=url, timeout=30) as client:
                times_s += [took_s(client), took_s(client)]
        assert max(times_s) < SOON_S, times_s


def test_a_crowd_costs_no_other_address_its_connection(port):
    """The oldest of all connections, idle, stays: it is not of the address with most of them."""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as early:
        early.sendall(HEAD)
        with crowd(port, b"", "127.0.0.2"):
            early.sendall(b"a\r\nConnection: close\r\n\r\n")
            assert early.recv(65536).startswith(b"HTTP/1.1 200 ")


@pytest.mark.flaky
@pytest.mark.parametrize("said", [b"", b"\x16\x03\x01"], ids=["nothing", "half a hello"])
def test_handshakes_that_do_not_come_take_no_more_places_than_requests(tls_port, certificate, said):
    url, trusted = f"https://127.0.0.1:{tls_port}", ssl.create_default_context(cafile=certificate[0])
    with crowd(tls_port, said, "127.0.0.1") as lines:
        times_s = []
        for _ in range(3):
            with httpx.Client(base_url=url, timeout=30, verify=trusted) as client:
                times_s.append(took_s(client))
        poll = select.poll()
        for line in lines:
            poll.register(line, select.POLLIN)
        ended = poll.poll(1000)
    assert max(times_s[1:]) < SOON_S, times_s
    assert len(ended) >= CROWD - connections.MOST_CONNECTIONS


def test_a_handshake_must_end_in_time_and_a_lost_one_leaves_nothing(tls_port, certificate, monkeypatch):
    monkeypatch.setattr(tls, "MOST_HEAD_S", 0.5)
    trusted = ssl.create_default_context(cafile=certificate[0])
    with socket.create_connection(("127.0.0.1", tls_port), timeout=10) as line:
        assert line.recv(100) == b""
    with httpx.Client(base_url=f"https://127.0.0.1:{tls_port}", verify=trusted) as client:
        took_s(client)
        took_s(client)


@pytest.mark.parametrize("files", [("cert.pem", "missing.pem"), ("key.pem", "key.pem")])
def test_a_certificate_that_cannot_be_used_is_one_sentence(certificate, files, tmp_path):
    cert, key = (str(Path(certificate[0]).with_name(name)) for name in files)
    settings = Settings(data=tmp_path / "data", tls_certificate=cert, tls_key=key)
    with pytest.raises(
        InvalidInput, match=r"tls_certificate and tls_key must be PEM files .* received .*pem: \S"
    ):
        http_of(settings)


@pytest.mark.parametrize(
    ("said", "letter"),
    [("nothing", b""), ("half a head", b"a"), ("half a body that is refused already", b" ")],
)
def test_a_letter_now_and_then_keeps_no_connection(port, said, letter, monkeypatch):
    """Each started the clock anew, so that a connection stayed for as long as its client liked."""
    monkeypatch.setattr(connections, "MOST_HEAD_S", 0.5)
    begin_s = time.monotonic()
    with socket.create_connection(("127.0.0.1", port), timeout=0.1) as line, suppress(ConnectionError):
        line.sendall(SAID[said])
        received = b"?"
        while received and time.monotonic() - begin_s < 10:
            line.sendall(letter)
            with suppress(TimeoutError):
                received = line.recv(65536)
    assert time.monotonic() - begin_s < 5


def test_a_body_may_take_longer_than_a_head(port, monkeypatch):
    monkeypatch.setattr(connections, "MOST_HEAD_S", 0.3)
    of_others = "127.0.0.3", 0  # no guesses of the crowds count for it
    with socket.create_connection(("127.0.0.1", port), timeout=10, source_address=of_others) as line:
        line.sendall(BODY)
        for _ in range(98):  # the rest of its length
            time.sleep(0.01)
            line.sendall(b" ")
        assert line.recv(65536).startswith(b"HTTP/1.1 4")
