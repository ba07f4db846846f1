"""Floods, guesses of tokens and bodies that trickle in are refused; what is counted is what happened."""

from __future__ import annotations

import asyncio
import json
import time
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families
from starlette.testclient import TestClient

from estimator.service import bodies, metrics, rate_limits
from tests.estimator.service.conftest import append, bearer, begin_session, lines_of, refusal, upload_rig


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> None:
    """The middle of a minute, in which the windows of the limits begin."""
    begin_s = 60.0 * (time.time() // 60) + 20.0
    monkeypatch.setattr("limits.storage.memory.time.time", lambda: begin_s)
    monkeypatch.setattr(rate_limits.time, "time", lambda: begin_s)


@pytest.mark.usefixtures("still")
def test_a_token_has_so_many_requests_a_minute_and_another_token_its_own(idle):
    client = idle(require_tokens=True, most_requests_per_minute=5)
    anne, berta = bearer(client, "anne"), bearer(client, "berta")
    for _ in range(5):
        assert client.get("/v1/state", headers=anne).status_code == 200
    answer = client.get("/v1/state", headers=anne)
    assert refusal(answer, 429)["rule"] == "must be at most 5 a minute"
    assert 1 <= int(answer.headers["retry-after"]) <= 60
    assert client.get("/v1/state", headers=berta).status_code == 200


@pytest.mark.usefixtures("still")
def test_tokens_that_are_guessed_are_no_longer_looked_up(idle, monkeypatch):
    client = idle(require_tokens=True, most_refused_per_minute=3)
    valid = bearer(client, "anne")
    for guess in ("a", "b", "c"):
        refusal(client.get("/v1/state", headers={"Authorization": f"Bearer {guess}"}), 401)
    monkeypatch.setattr("estimator.service.guard.caller_of", None)
    answer = client.get("/v1/state", headers={"Authorization": "Bearer d"})
    assert refusal(answer, 429)["rule"] == "must be at most 3 a minute without a valid token"
    refusal(client.get("/v1/state", headers=valid), 429)


def test_loopback_without_tokens_has_no_rate(idle):
    client = idle(most_requests_per_minute=1)
    assert [client.get("/v1/state").status_code for _ in range(5)] == [200] * 5


def posted(path: str) -> dict[str, Any]:
    """The head of a request, for the application itself."""
    headers = [(b"host", b"127.0.0.1:8765"), (b"content-type", b"application/yaml")]
    scope = {"type": "http", "method": "POST", "scheme": "http", "path": path, "raw_path": path.encode()}
    return scope | {"query_string": b"", "headers": headers, "client": ("127.0.0.1", 5), "root_path": ""}


def test_a_body_that_trickles_in_is_refused_when_its_time_is_over(idle):
    client = idle(most_body_s=0.3)
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        await asyncio.sleep(0.02)
        return {"type": "http.request", "body": b" ", "more_body": True}

    async def send(message: Any) -> None:
        sent.append(message)

    begin_s = time.monotonic()
    asyncio.run(client.app(posted("/v1/rigs"), receive, send))
    assert time.monotonic() - begin_s < 5.0
    assert sent[0]["status"] == 408
    assert json.loads(sent[1]["body"])["rule"] == "must arrive within 0.3 s"


def test_who_has_not_said_who_it_is_sends_no_more_than_a_token(idle):
    """A thousand connections with bodies of 32 MB each to the login would have taken 32 GB."""
    client = idle(require_tokens=True)
    problem = refusal(client.post("/v1/login", content=b" " * 10_001), 413)
    assert problem["rule"] == "must have at most 10000 bytes"
    headers = {"Content-Type": "application/json"}
    refusal(client.post("/v1/login", content=b'{"token": "guess"}', headers=headers), 401)


def test_bodies_of_all_requests_together_have_an_end_and_their_room_comes_back(idle, monkeypatch):
    monkeypatch.setattr(bodies, "MOST_BODIES", 3)
    client = idle(most_body_MB=1e-3)

    async def crowd() -> list[int]:
        is_over, statuses = asyncio.Event(), []

        async def one() -> None:
            pieces = iter([{"type": "http.request", "body": b" " * 900, "more_body": True}])

            async def receive() -> dict[str, Any]:
                if (piece := next(pieces, None)) is not None:
                    return piece
                await is_over.wait()
                return {"type": "http.request", "body": b"", "more_body": False}

            async def send(message: Any) -> None:
                statuses.extend([message["status"]] if "status" in message else [])

            await client.app(posted("/v1/rigs"), receive, send)

        tasks = [asyncio.create_task(one()) for _ in range(5)]
        while len(statuses) < 2:
            await asyncio.sleep(0.01)
        is_over.set()
        await asyncio.gather(*tasks)
        return statuses

    for _ in range(2):  # what the first ones held is free again
        assert asyncio.run(asyncio.wait_for(crowd(), 30)) == [429, 429, 422, 422, 422]


def samples(
    client: TestClient, headers: dict[str, str] | None = None
) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    answer = client.get("/metrics", headers=headers)
    assert answer.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    found = {}
    for family in text_string_to_metric_families(answer.text):
        assert family.documentation
        for sample in family.samples:
            found[sample.name, tuple(sorted(sample.labels.items()))] = sample.value
    return found


def test_requests_readings_sessions_and_jobs_are_counted(idle, rig_text, small_session, small_rig):
    client = idle()
    rig_id = upload_rig(client, rig_text)
    session_id = begin_session(client, rig_id)
    assert append(client, session_id, lines_of(small_session, small_rig)).status_code == 200
    append(client, session_id, lines_of(small_session, small_rig))  # again: acknowledged once
    client.post(f"/v1/sessions/{session_id}/close")
    client.post("/v1/jobs/calibrate", json={"session_id": session_id})
    client.get("/v1/sessions/" + "f" * 32)
    client.get("/v1/nothing/" + "f" * 32)
    client.request("STEAL", "/v1/state")
    with client.app.state.core.predictor.limit.taken():
        counted = samples(client)

    def requests(method: str, route: str, status: int) -> float:
        return counted[
            "coilcal_requests_total", (("method", method), ("route", route), ("status", str(status)))
        ]

    assert requests("POST", "/v1/sessions/{session_id}/readings", 200) == 2
    assert requests("GET", "/v1/sessions/{session_id}", 404) == 1
    assert requests("GET", metrics.NO_ROUTE, 404) == 1
    assert (
        sum(
            v
            for (name, labels), v in counted.items()
            if ("method", metrics.NO_ROUTE) in labels and "count" in name
        )
        == 1
    )
    assert counted["coilcal_readings_acknowledged_total", ()] == len(small_session.observations)
    assert counted["coilcal_jobs", (("state", "queued"),)] == 1
    assert counted["coilcal_jobs", (("state", "failed"),)] == 0
    assert counted["coilcal_predictions_waiting", ()] == 1
    assert counted["coilcal_event_streams", ()] == 0
    assert counted["coilcal_sessions", (("state", "closed"),)] == 1
    durations = ("method", "POST"), ("route", "/v1/sessions/{session_id}/readings")
    assert counted["coilcal_request_duration_seconds_count", durations] == 2
    assert counted["coilcal_request_duration_seconds_sum", durations] > 0
    assert not any(session_id in str(key) for key in counted)


def test_a_fault_of_the_service_is_counted_and_has_the_headers_of_every_answer(idle, monkeypatch, caplog):
    def fails(*_: object, **__: object) -> None:
        raise RuntimeError("a secret")

    monkeypatch.setattr("estimator.service.answers.Listing.page", fails)
    client = idle()
    answer = client.get("/v1/rigs")
    told = refusal(answer, 500)
    assert "a secret" not in answer.text
    assert answer.headers["x-content-type-options"] == "nosniff"
    labels = ("method", "GET"), ("route", "/v1/rigs"), ("status", "500")
    assert samples(client)["coilcal_requests_total", labels] == 1
    (fault,) = (record for record in caplog.records if record.levelname == "ERROR")
    assert (fault.request_id, str(fault.exc_info[1])) == (told["request_id"], "a secret")


def test_a_fault_before_the_routes_is_counted_and_told_in_words_too(idle, monkeypatch):
    def fails(*_: object) -> None:
        raise OSError("a disk is full")

    client = idle(require_tokens=True)
    anne = bearer(client, "anne")
    with monkeypatch.context() as patched:
        patched.setattr("estimator.service.guard.caller_of", fails)
        answer = client.get("/v1/state", headers=anne)
    refusal(answer, 500)
    assert "a disk is full" not in answer.text
    assert answer.headers["x-content-type-options"] == "nosniff"
    labels = ("method", "GET"), ("route", metrics.NO_ROUTE), ("status", "500")
    assert samples(client, anne)["coilcal_requests_total", labels] == 1
