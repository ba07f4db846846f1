"""A client that says what it wants is answered at once beside any number of connections that do not."""

from __future__ import annotations

import resource
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress

import httpx
import pytest

from estimator.service import connections
from estimator.service.app import create_app
from estimator.service.connections import allow_files
from estimator.service.settings import Settings
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
@pytest.mark.parametrize("address", ["127.0.0.1", "127.0.0.2"])
@pytest.mark.parametrize("said", SAID.values(), ids=SAID)
def test_a_client_is_answered_soon_beside_a_crowd(port: int, said: bytes, address: str) -> None:
    """From the crowd's own address too, as behind a proxy."""
    url = f"http://127.0.0.1:{port}"
    with crowd(port, said, address):
        with httpx.Client(base_url=url, timeout=30) as client:
            took_s(client)  # until the service has seen all of them
        times_s = []
        for _ in range(5):
            with httpx.Client(base_url=url, timeout=30) as client:
                times_s += [took_s(client), took_s(client)]
        assert max(times_s) < SOON_S, times_s


def test_a_crowd_costs_no_other_address_its_connection(port: int) -> None:
    """The oldest of all connections, idle, stays: it is not of the address with most of them."""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as early:
        early.sendall(HEAD)
        with crowd(port, b"", "127.0.0.2"):
            early.sendall(b"a\r\nConnection: close\r\n\r\n")
            assert early.recv(65536).startswith(b"HTTP/1.1 200 ")


def test_a_body_that_was_answered_already_is_not_waited_for(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A letter now and then kept such a connection for as long as its client liked."""
    monkeypatch.setattr(connections, "MOST_HEAD_S", 0.5)
    begin_s = time.monotonic()
    with socket.create_connection(("127.0.0.1", port), timeout=10) as line:
        line.sendall(SAID["half a body that is refused already"])
        assert line.recv(65536).startswith(b"HTTP/1.1 4")  # 401, or 429 after the crowds
        with suppress(ConnectionError):
            while time.monotonic() - begin_s < 10:
                line.sendall(b" ")
                time.sleep(0.1)
    assert time.monotonic() - begin_s < 5
