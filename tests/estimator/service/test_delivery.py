"""Readings that are delivered while they are measured arrive once, whatever is killed, cut off or answered too late."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.testclient import TestClient

from estimator.cli import delivery
from estimator.cli.delivery import Delivery, Receipt, connected
from estimator.client import Client
from estimator.errors import CorruptStore, InvalidInput
from estimator.rig.rig import Rig
from estimator.service.tokens import Scope, create_token
from estimator.store.growing import StopReadings, new_header
from estimator.store.journal import Journal
from estimator.store.session import Session, seal
from tests.estimator.service.conftest import until

URL = "http://127.0.0.1:8765"
PATIENCE_S = 60.0


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(delivery, "FIRST_PAUSE_S", 0.05)
    monkeypatch.setattr(delivery, "LONGEST_PAUSE_S", 0.2)
    monkeypatch.setattr(delivery, "LOOK_EVERY_S", 0.01)
    monkeypatch.setattr(delivery, "MOST_AT_ONCE", 7)


class Through(httpx.BaseTransport):
    """A connection to a service in this process whose answers are lost now and then, after the service has done what was asked."""

    def __init__(self, service: TestClient, is_lost: Callable[[int], bool] = lambda _: False) -> None:
        self.service, self.is_lost, self.n = service, is_lost, 0

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        self.n += 1
        answer = self.service.request(
            request.method, str(request.url), content=request.read(), headers=dict(request.headers)
        )
        if self.is_lost(self.n):
            raise httpx.ReadError("cut off")
        headers = {name: value for name, value in answer.headers.items() if name != "content-encoding"}
        return httpx.Response(answer.status_code, headers=headers, content=answer.content)


def stops(n: int) -> list[dict[str, Any]]:
    """Readings of a sensor that once is beyond its range, of a coil with a thermometer."""
    made = []
    for i in range(n):
        nan = float("nan")
        field_T = (nan, nan, nan) if i == 3 else (1e-3 * i, nan if i == 5 else 0.0, -1e-3)
        made.append(
            StopReadings(
                time_s=0.5 * i,
                current_A=[3.0],
                motion={"arm1": [1e-3 * i] * 6},
                field_T={"hall": field_T},
                is_validation=i % 5 == 0,
                repeat=i % 2,
                measured_A={"coil1": 3.0 + 1e-4 * i},
                temperature_C={"coil1": nan if i == 2 else 20.0 + i},
                sd_T={"hall": (1e-6,) * 3},
                n_readings=10,
            ).entry()
        )
    return made


def begun(session: Path, rig: Rig) -> Journal:
    return Journal.create(session, new_header(rig, "bench, with a long name: " + "x" * 600, "plan", {}))


def measured(session: Path, rig: Rig, n: int) -> Session:
    """A session that was measured while nothing was delivered."""
    with begun(session, rig) as journal:
        journal.append_all(stops(n))
    return seal(session)


def delivered(session: Path, client: Client, patience_s: float = PATIENCE_S) -> Receipt:
    told: list[str] = []
    task = Delivery(session, client, URL, told.append)
    task.start()
    receipt = task.finish(patience_s)
    assert task.fault is None, task.fault
    return receipt


@pytest.mark.parametrize("every", [3, 4, 5])
def test_answers_that_are_lost_change_nothing(idle, small_rig, tmp_path, every):
    service = idle()
    session = measured(tmp_path / "s.zarr", small_rig, 40)
    transport = Through(service, lambda n: n % every == 0)
    receipt = delivered(tmp_path / "s.zarr", Client(URL, transport=transport, attempts=1))
    assert receipt.hash == session.hash
    assert receipt.n_acknowledged == 40
    found = service.get("/v1/sessions").json()["items"]
    assert [(s["id"], s["state"], s["n_readings"]) for s in found] == [(receipt.session_id, "closed", 40)]
    assert Receipt.load(tmp_path / "s.zarr") == receipt


def test_a_delivery_goes_on_where_another_process_has_left_it(idle, small_rig, tmp_path):
    service = idle()
    path = tmp_path / "s.zarr"
    with begun(path, small_rig) as journal:
        journal.append_all(stops(40)[:20])
        first = Delivery(path, Client(URL, transport=Through(service), attempts=1), URL, lambda _: None)
        first.start()
        until(lambda: first.receipt.n_acknowledged == 20)
        first.stop()
        journal.append_all(stops(40)[20:])
    session = seal(path)
    assert Receipt.load(path) == first.receipt
    assert first.receipt.hash is None
    (path / "delivery.json").unlink()  # as if the disk had forgotten all but the key
    Receipt(URL, first.receipt.key).save(path)
    receipt = delivered(path, Client(URL, transport=Through(service), attempts=1))
    assert (receipt.session_id, receipt.hash) == (first.receipt.session_id, session.hash)
    again = delivered(path, Client(URL, transport=Through(service, lambda _: True), attempts=1))
    assert again == receipt  # nothing is asked of a service that has all


def test_an_outage_is_told_once_and_its_end_too(idle, small_rig, tmp_path):
    measured(tmp_path / "s.zarr", small_rig, 20)
    told: list[str] = []
    transport = Through(idle(), lambda n: 3 <= n < 9)
    task = Delivery(tmp_path / "s.zarr", Client(URL, transport=transport, attempts=1), URL, told.append)
    task.start()
    assert task.finish(PATIENCE_S).hash is not None
    assert len(told) == 2
    assert "must answer" in told[0]
    assert "answers again" in told[1]


def test_a_session_goes_to_one_service(idle, small_rig, tmp_path):
    client = Client(URL, transport=Through(idle()), attempts=1)
    path = tmp_path / "s.zarr"
    measured(path, small_rig, 8)
    assert delivered(path, client).hash is not None
    with pytest.raises(
        InvalidInput, match="must be delivered to one service, http://127.0.0.1:8765; received"
    ):
        Delivery(path, client, "http://other.example", lambda _: None)
    assert Delivery(path, client, "http://other.example", lambda _: None, is_new=True).receipt.hash is None
    (path / "delivery.json").write_text("[]", encoding="utf-8")
    with pytest.raises(CorruptStore, match="delivery.json must hold a JSON object"):
        Delivery(path, client, URL, lambda _: None)


def test_a_service_that_refuses_ends_the_delivery_and_nothing_else(idle, small_rig, tmp_path):
    service = idle(most_readings=10)
    measured(tmp_path / "s.zarr", small_rig, 20)
    told: list[str] = []
    task = Delivery(
        tmp_path / "s.zarr", Client(URL, transport=Through(service), attempts=1), URL, told.append
    )
    task.start()
    receipt = task.finish(PATIENCE_S)
    assert receipt.hash is None
    assert receipt.n_acknowledged == 7
    assert task.fault is not None
    assert "must have at most 10 readings" in task.fault


def test_a_token_that_only_reads_is_refused_before_anything_is_measured(idle, monkeypatch):
    service = idle(require_tokens=True)
    secret, _ = create_token(service.app.state.core.database, "anne", Scope.READ, 1.0)
    monkeypatch.setattr(
        delivery, "Client", lambda url, token, attempts: Client(url, token, Through(service), attempts)
    )
    with pytest.raises(InvalidInput, match="must have the scope write"):
        connected(URL, secret, lambda _: None)
    with pytest.raises(InvalidInput, match="token must be given"):
        connected(URL, None, lambda _: None)
    with pytest.raises(InvalidInput, match="must be an http or https address"):
        connected("ftp://x", None, lambda _: None)
