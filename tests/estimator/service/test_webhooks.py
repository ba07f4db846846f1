"""Webhooks are told once they answer, signed, and never at an address that only the service reaches."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import json
import socket
import threading
import time
from base64 import b64decode, b64encode
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest
from sqlalchemy import update
from starlette.testclient import TestClient

from estimator.service import post as post_module
from estimator.service import webhooks
from estimator.service.app import create_app
from estimator.service.post import Undelivered, post, signature
from estimator.service.schema import Delivery
from estimator.service.settings import Settings
from tests.estimator.service.conftest import refusal, until

LOOPBACK = ("127.0.0.0/8",)


class Receiver:
    """A receiver at loopback that answers as it is told, and remembers what it got."""

    def __init__(self) -> None:
        self.answers: list[int] = []
        self.got: list[tuple[dict[str, str], bytes, str]] = []
        self.may_answer = threading.Event()
        self.may_answer.set()
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                headers = {name.lower(): value for name, value in self.headers.items()}
                receiver.got.append((headers, body, self.path))
                receiver.may_answer.wait(60)
                status = receiver.answers.pop(0) if receiver.answers else 204
                self.send_response(status)
                if status == 302:
                    self.send_header("Location", f"{receiver.url}/elsewhere")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: Any) -> None:
                pass

        self.server = HTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        self.thread = threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.01})
        self.thread.start()

    def close(self) -> None:
        self.server.shutdown()
        self.thread.join()
        self.server.server_close()


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    receiver = Receiver()
    yield receiver
    receiver.close()


def made(client: TestClient, url: str) -> dict[str, Any]:
    answer = client.post("/v1/webhooks", json={"url": url})
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def deliver(client: TestClient) -> int:
    threads = client.app.state.core.deliveries.begin_due()
    for thread in threads:
        thread.join(60)
    return len(threads)


def log_of(client: TestClient, webhook: dict[str, Any]) -> list[dict[str, Any]]:
    return list(client.get(f"/v1/webhooks/{webhook['id']}/deliveries").json()["items"])


def make_due(client: TestClient) -> None:
    with client.app.state.core.database.writing() as db:
        db.execute(update(Delivery).where(Delivery.state == "waiting").values(next_attempt="2000-01-01"))


def posted(url: str, networks: tuple[str, ...] = ()) -> int:
    return asyncio.run(post(url, "whsec_AAAA", "1", 1, b"{}", networks))


def test_the_signature_is_that_of_the_specification():
    secret, body = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", b'{"test": 2432232314}'
    signed = signature(secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, body)
    assert signed == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_the_end_of_a_job_is_told_signed_once(filled, receiver):
    client, session_id = filled(webhook_networks=LOOPBACK)
    webhook = made(client, f"{receiver.url}/hook?lab=1")
    job = client.post("/v1/jobs/calibrate", json={"session_id": session_id}).json()
    assert deliver(client) == 0
    client.post(f"/v1/jobs/{job['id']}/cancel")
    client.post(f"/v1/jobs/{job['id']}/cancel")
    assert deliver(client) == 1
    assert deliver(client) == 0
    ((headers, body, path),) = receiver.got
    told = json.loads(body)
    assert (told["type"], told["data"]["id"], told["data"]["state"]) == ("job.ended", job["id"], "cancelled")
    assert path == "/hook?lab=1"
    assert headers["host"] == receiver.url.removeprefix("http://")
    assert abs(int(headers["webhook-timestamp"]) - time.time()) < 60
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    key = b64decode(webhook["secret"].removeprefix("whsec_"))
    expected = b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    assert headers["webhook-signature"] == f"v1,{expected}"
    (entry,) = log_of(client, webhook)
    assert (entry["state"], entry["attempts"], entry["status"]) == ("delivered", 1, 204)
    assert entry["id"] == headers["webhook-id"]
    assert "secret" not in client.get("/v1/webhooks").json()["items"][0]


def test_jobs_that_are_done_and_that_fail_are_told_too(filled, receiver):
    client, session_id = filled(webhook_networks=LOOPBACK)
    made(client, receiver.url)
    queue = client.app.state.core.queue
    for state, fault in (("done", None), ("failed", "rig must fit")):
        client.post("/v1/jobs/calibrate", json={"session_id": session_id})
        queue.end(queue.next().id, {"state": state, "fault": fault, "verdict": "good"})
    while deliver(client):
        pass
    told = [json.loads(body)["data"] for _, body, _ in receiver.got]
    assert [(data["state"], data["fault"]) for data in told] == [("done", None), ("failed", "rig must fit")]
    assert told[0]["result"]["verdict"] == "good"


def test_what_is_not_taken_is_tried_again_later_and_later_and_then_given_up(idle, receiver):
    client = idle(webhook_networks=LOOPBACK)
    webhook = made(client, receiver.url)
    receiver.answers = [500, 302, 404, 200]
    client.post(f"/v1/webhooks/{webhook['id']}/test")
    for number, words in enumerate(("answers 500", "answers 302", "answers 404")):
        assert deliver(client) == 1
        (entry,) = log_of(client, webhook)
        assert (entry["state"], entry["attempts"]) == ("waiting", number + 1)
        assert words in entry["fault"]
        pause_s = (datetime.fromisoformat(entry["next_attempt"]) - datetime.now(UTC)).total_seconds()
        assert webhooks.PAUSES_S[number] - 20 < pause_s <= webhooks.PAUSES_S[number]
        assert deliver(client) == 0  # not due
        make_due(client)
    assert deliver(client) == 1
    assert log_of(client, webhook)[0]["state"] == "delivered"
    assert len({headers["webhook-id"] for headers, _, _ in receiver.got}) == 1
    assert {path for _, _, path in receiver.got} == {"/"}  # the redirect was not followed
    receiver.answers = [503] * 20
    client.post(f"/v1/webhooks/{webhook['id']}/test")
    for _ in range(len(webhooks.PAUSES_S) + 1):
        make_due(client)
        assert deliver(client) == 1
    make_due(client)
    assert deliver(client) == 0
    failed = log_of(client, webhook)[0]
    assert (failed["state"], failed["attempts"]) == ("failed", len(webhooks.PAUSES_S) + 1)


def test_a_receiver_that_hangs_holds_up_no_other(idle, receiver, monkeypatch):
    monkeypatch.setattr(post_module, "MOST_S", 3.0)
    slow = Receiver()
    try:
        slow.may_answer.clear()
        client = idle(webhook_networks=LOOPBACK)
        hanging, quick = made(client, slow.url), made(client, receiver.url)
        for webhook in (hanging, quick, quick):
            client.post(f"/v1/webhooks/{webhook['id']}/test")
        begin_s = time.monotonic()
        begun = client.app.state.core.deliveries.begin_due()
        while len(receiver.got) < 1:
            time.sleep(0.01)
        begun[-1].join(60)
        assert deliver(client) == 1  # the next of the quick one, while the other hangs
        assert begun[0].is_alive()
        assert [entry["state"] for entry in log_of(client, quick)] == ["delivered"] * 2
        client.app.state.core.deliveries.stop()
        assert time.monotonic() - begin_s < 20
        assert log_of(client, hanging)[0]["fault"] == "receiver must answer within 3 s"
    finally:
        slow.may_answer.set()
        slow.close()


PRIVATE = ("127.0.0.1", "10.0.0.1", "192.168.1.1", "169.254.169.254", "100.64.0.1", "0.0.0.0", "224.0.0.1", "[::1]",
           "[::ffff:10.0.0.1]", "[64:ff9b::a00:1]", "[2002:a00:1::]", "[fe80::1]", "[fc00::1]", "[::7f00:1]", "[2001:0:a00::1]",
           "[::ffff:0:127.0.0.1]", "[64:ff9b:1::7f00:1]", "[ff02::1]", "[fe80::1%25lo]", "255.255.255.255", "198.18.0.1", "192.0.0.170",
           "127.1", "127.0.1", "0x7f000001", "2130706433", "017700000001", "0x0a.0.1", "0")  # fmt: skip
NO_URLS = ("ftp://example.com", "http://", "http:///x", "//example.com", "http://a:b@example.com", "file:///etc/passwd",
           "http://example.com:99999", "http://example.com:0/", "http://example.com:-1", "http://example.com/#x",
           "http://10.0.0.1\\@example.com/", "http://example.com\\@10.0.0.1/", "http://example.com:80@10.0.0.1/", "http://%31%32%37.0.0.1/",
           "http://127。0。0。1/", "http://①②⑦.0.0.1/", "http://127.0.0.1./", "http://0177.0.0.1/", "data:text/plain,x", "ws://example.com/", "http://exa mple.com",
           "http://example.com\r\nX-Injected: 1/", "javascript:1", "http://[::1")  # fmt: skip


def test_private_addresses_and_what_is_no_address_are_refused(idle):
    client = idle()
    for host in PRIVATE:
        answer = client.post("/v1/webhooks", json={"url": f"http://{host}/hook"})
        assert "must not be at a private address" in refusal(answer, 422)["rule"], host
    for url in NO_URLS:
        assert refusal(client.post("/v1/webhooks", json={"url": url}), 422)["thing"] == "url", url
    assert client.get("/v1/webhooks").json()["items"] == []
    made(client, "https://[2606:2800:220:1:248:1893:25c8:1946]:8443/hook")


@pytest.mark.parametrize("addresses", [["127.0.0.1"], ["93.184.216.34", "127.0.0.1"], ["::ffff:127.0.0.1"]])
def test_a_name_of_a_private_address_is_refused_when_it_is_looked_up(idle, receiver, monkeypatch, addresses):
    client = idle()
    port = receiver.url.rpartition(":")[2]
    webhook = made(client, f"http://rebound.example:{port}/hook")
    found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, int(port))) for address in addresses]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    client.post(f"/v1/webhooks/{webhook['id']}/test")
    assert deliver(client) == 1
    assert "must not be at a private address" in log_of(client, webhook)[0]["fault"]
    assert receiver.got == []


def test_the_connection_goes_to_the_address_that_was_checked_and_names_the_host(idle, receiver, monkeypatch):
    client = idle(webhook_networks=LOOPBACK)
    port = receiver.url.rpartition(":")[2]
    webhook = made(client, f"http://hooks.example:{port}/hook")
    asked: list[str] = []

    def look_up(host: Any, *_: Any, **__: Any) -> Any:
        asked.append(str(host))
        address = "127.0.0.1" if len(asked) == 1 else "203.0.113.1"  # another answer to a second question
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (address, int(port)))]

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    client.post(f"/v1/webhooks/{webhook['id']}/test")
    assert deliver(client) == 1
    assert log_of(client, webhook)[0]["state"] == "delivered"
    assert receiver.got[0][0]["host"] == f"hooks.example:{port}"
    assert asked[0] == "hooks.example"
    assert "hooks.example" not in asked[1:]


def test_a_name_server_that_is_slow_takes_no_more_time_than_the_receiver_has(monkeypatch):
    monkeypatch.setattr(post_module, "MOST_S", 0.2)
    is_over = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: is_over.wait(30) and [])
    begin_s = time.monotonic()
    with pytest.raises(Undelivered, match=r"must answer within 0\.2 s"):
        posted("http://slow.example/")
    assert time.monotonic() - begin_s < 15
    is_over.set()


HEAD = b"HTTP/1.1 200 OK\r\n"
ANSWERS = {  # first bytes, those that follow without an end, and what is said of them
    "a body without an end": (HEAD + b"Content-Length: 99999999999\r\n\r\n", b"x" * 65536, "200"),
    "a body that unfolds": (
        HEAD + b"Content-Encoding: gzip\r\nContent-Length: 9999\r\n\r\n",
        b"\x1f\x8b\x08",
        "200",
    ),
    "chunks without an end": (
        b"HTTP/1.1 500 No\r\nTransfer-Encoding: chunked\r\n\r\n",
        b"1\r\nx\r\n",
        "it answers 500",
    ),
    "a head without an end": (HEAD, b"X: " + b"a" * 1000 + b"\r\n", "Receive buffer too long"),
    "a line without an end": (HEAD + b"X: ", b"a" * 65536, "Receive buffer too long"),
    "more to come, without an end": (b"", b"HTTP/1.1 103 Early Hints\r\n\r\n" * 100, "must answer within"),
    "another protocol": (b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: x\r\n\r\n", b"", "must be reached"),
    "no status": (b"\x00\xff" * 100, b"", "must be reached"),
    "elsewhere": (
        b"HTTP/1.1 307 X\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n",
        b"",
        "it answers 307",
    ),
}


@pytest.mark.parametrize("name", ANSWERS)
def test_an_answer_without_an_end_ends(monkeypatch, name):
    monkeypatch.setattr(post_module, "MOST_S", 2.0)
    first, more, expected = ANSWERS[name]
    listener = socket.create_server(("127.0.0.1", 0))

    def answer() -> None:
        line, _ = listener.accept()
        with line, suppress(OSError):
            line.recv(65536)
            line.sendall(first)
            while more:
                line.sendall(more)

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        said = str(posted(f"http://127.0.0.1:{listener.getsockname()[1]}/", LOOPBACK))
    except Undelivered as undelivered:
        said = str(undelivered)
    thread.join(30)
    listener.close()
    assert expected in said
    assert not thread.is_alive()  # the connection was closed


def test_deleted_webhooks_are_told_nothing_and_old_messages_are_forgotten(idle, receiver):
    client = idle(webhook_networks=LOOPBACK)
    webhook, other = made(client, receiver.url), made(client, receiver.url)
    for each in (webhook, other):
        client.post(f"/v1/webhooks/{each['id']}/test")
    assert client.delete(f"/v1/webhooks/{webhook['id']}").status_code == 204
    refusal(client.delete(f"/v1/webhooks/{webhook['id']}"), 404)
    assert deliver(client) == 1
    old = (datetime.now(UTC) - timedelta(days=webhooks.KEPT_DAYS + 1)).isoformat(timespec="milliseconds")
    client.post(f"/v1/webhooks/{other['id']}/test")
    core = client.app.state.core
    core.deliveries.remove_old()
    assert len(log_of(client, other)) == 2
    with core.database.writing() as db:
        db.execute(update(Delivery).values(created=old))
    core.deliveries.remove_old()
    assert [entry["state"] for entry in log_of(client, other)] == ["waiting"]


def test_the_number_of_webhooks_is_limited(idle):
    client = idle()
    for number in range(20):
        made(client, f"https://hooks.example/{number}")
    refusal(client.post("/v1/webhooks", json={"url": "https://hooks.example/more"}), 409)


def test_a_service_that_runs_tells_by_itself(receiver, tmp_path, monkeypatch):
    monkeypatch.setattr(webhooks, "LOOK_EVERY_S", 0.05)
    app = create_app(Settings(data=tmp_path / "data", webhook_networks=LOOPBACK), has_workers=False)
    with TestClient(app, base_url="http://127.0.0.1:8765") as client:
        client.app.state.core.periodic.start()
        webhook = made(client, receiver.url)
        client.post(f"/v1/webhooks/{webhook['id']}/test")
        until(lambda: receiver.got)
    assert len(receiver.got) == 1
