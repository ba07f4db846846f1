"""A disk that is full, read-only or broken is no fault of a request: it is told so, waits at the client, and is accepted later."""

from __future__ import annotations

import errno
import os
import sqlite3
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest.mock import create_autospec

import pytest
from distributed import Future
from sqlalchemy import event
from starlette.testclient import TestClient

from estimator.batching.engine import Cluster
from estimator.cli import delivery
from estimator.cli.delivery import Delivery
from estimator.client import Client
from estimator.service import storage
from estimator.service.core import Core
from estimator.service.dispatcher import Dispatcher
from estimator.service.storage import Storage
from estimator.store.growing import observations_of
from estimator.store.session import load_session, seal
from tests.estimator.service.conftest import (
    CSV,
    append,
    begin_session,
    import_csv,
    lines_of,
    refusal,
    send_zip,
    sent,
    until,
    upload_rig,
)
from tests.estimator.service.test_delivery import PATIENCE_S, URL, Through, begun, stops


class Disk:
    """The disk under a folder: while `code` is set, nothing that is written there can be put on it."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder, self.code = folder, 0
        original = os.fsync

        def fsync(descriptor: int) -> None:
            if self.code and Path(f"/proc/self/fd/{descriptor}").readlink().is_relative_to(self.folder):
                raise OSError(self.code, os.strerror(self.code))
            original(descriptor)

        monkeypatch.setattr(os, "fsync", fsync)


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Disk:
    monkeypatch.setattr(storage, "PROBE_EVERY_S", 0.0)
    return Disk(tmp_path / "data", monkeypatch)


@pytest.fixture
def ready(idle: Callable[..., TestClient], monkeypatch: pytest.MonkeyPatch) -> TestClient:
    """A service without workers that would be ready if they were there."""
    monkeypatch.setattr(Dispatcher, "is_ready", True)
    return idle()


def test_readings_wait_while_the_disk_of_the_service_is_full_and_all_arrive_once(
    ready, disk, small_rig, tmp_path, monkeypatch
):
    monkeypatch.setattr(delivery, "FIRST_PAUSE_S", 0.05)
    monkeypatch.setattr(delivery, "LONGEST_PAUSE_S", 0.1)
    monkeypatch.setattr(delivery, "MOST_AT_ONCE", 7)
    told: list[str] = []

    path = tmp_path / "s.zarr"
    assert ready.get("/readyz").status_code == 200
    with begun(path, small_rig) as journal:
        journal.append_all(stops(40)[:20])
        sending = Delivery(path, Client(URL, transport=Through(ready), attempts=1), URL, told.append)
        sending.start()
        until(lambda: sending.receipt.n_acknowledged == 20)
        disk.code = errno.ENOSPC
        journal.append_all(stops(40)[20:])
        until(lambda: len(told) == 1)
        assert "service must have room on its disk; it has none: No space left on device" in told[0]
        assert "readings wait in" in told[0]
        assert "No space left" in refusal(ready.get("/readyz"), 507)["detail"]
        time.sleep(0.3)  # some more attempts
        assert (len(told), sending.receipt.n_acknowledged, sending.fault) == (1, 20, None)
    session = seal(path)
    disk.code = 0
    receipt = sending.finish(PATIENCE_S)
    assert (receipt.hash, receipt.n_acknowledged) == (session.hash, 40)
    assert "answers again" in told[1]
    assert ready.get("/readyz").status_code == 200
    stored = load_session(tmp_path / "data" / "sessions" / f"{receipt.session_id}.zarr")
    assert stored.observations.time_s.tolist() == [entry["time_s"] for entry in stops(40)]
    assert len(observations_of(stops(40), small_rig)) == len(stored.observations)


@pytest.mark.parametrize(
    ("code", "status"),
    [(errno.ENOSPC, 507), (errno.EDQUOT, 507), (errno.EROFS, 503), (errno.EIO, 503), (errno.EMFILE, 503)],
)
def test_no_request_that_writes_is_blamed_for_the_disk(
    ready, disk, rig_text, readings_csv, small_session, small_rig, code, status
):
    rig_id = upload_rig(ready, rig_text)
    session_id = begin_session(ready, rig_id)
    lines = lines_of(small_session, small_rig)
    first = lines.splitlines(keepends=True)[0]
    assert append(ready, session_id, first).json()["n_readings"] == 1
    of_rig = f"/v1/sessions/import-csv?rig_id={rig_id}"

    def requests() -> Iterator[Callable[[], int]]:
        yield lambda: ready.post("/v1/sessions", json={"rig_id": rig_id, "source": "x"}).status_code
        yield lambda: append(ready, session_id, lines).status_code
        yield lambda: sent(ready, of_rig, readings_csv, CSV).status_code
        yield lambda: ready.post(f"/v1/sessions/{session_id}/close").status_code

    disk.code = code
    assert [request() for request in requests()] == [status] * 4
    answer = ready.get("/readyz")
    assert os.strerror(code) in refusal(answer, status)["detail"]
    assert int(answer.headers["retry-after"]) > 0
    disk.code = 0
    assert [request() for request in requests()] == [201, 200, 201, 200]
    assert ready.get("/readyz").status_code == 200
    assert not (disk.folder / storage.PROBE).exists()


def test_an_archive_that_finds_no_room_is_not_called_damaged(ready, rig_text, readings_csv, monkeypatch):
    rig_id = upload_rig(ready, rig_text)
    session_id = import_csv(ready, rig_id, readings_csv)["id"]
    archive = ready.get(f"/v1/sessions/{session_id}/session.zip").content

    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("estimator.service.archives._unpack_file", full)
    refusal(send_zip(ready, rig_id, archive), 507)


def test_a_database_without_room_is_told_as_such_and_is_whole_afterwards(ready, rig_text):
    """SQLite itself refuses here: its file may not have one page more."""
    core: Core = ready.app.state.core
    rig_id = upload_rig(ready, rig_text)
    with core.database.engine.connect() as connection:
        n_pages = connection.exec_driver_sql("PRAGMA page_count").scalar()

    def no_more(connection: sqlite3.Connection, _: object) -> None:
        connection.execute(f"PRAGMA max_page_count={n_pages}")

    core.database.close()
    event.listen(core.database.engine, "connect", no_more)
    body = {"rig_id": rig_id, "source": "x" * 400}
    answers = [ready.post("/v1/sessions", json=body) for _ in range(60)]
    assert {answer.status_code for answer in answers} == {201, 507}
    assert "database or disk is full" not in answers[-1].text
    assert refusal(answers[-1], 507)["thing"] == "service"
    n_begun = sum(answer.status_code == 201 for answer in answers)
    event.remove(core.database.engine, "connect", no_more)
    core.database.close()
    assert len(ready.get("/v1/sessions", params={"limit": 200}).json()["items"]) == n_begun
    assert len(list((core.data / "sessions").iterdir())) == n_begun  # no folder without its row
    assert ready.post("/v1/sessions", json=body).status_code == 201


def test_a_job_that_finds_no_room_for_its_folder_waits_for_it(filled, disk):
    client, session_id = filled()
    core: Core = client.app.state.core
    job_id = client.post("/v1/jobs/calibrate", json={"session_id": session_id}).json()["id"]
    disk.code = errno.ENOSPC

    workers = create_autospec(Cluster, instance=True)
    workers.start.return_value = create_autospec(Future, instance=True)
    for _ in range(2):
        assert core.jobs._looked(workers) > 1.0
        assert not workers.start.called
    disk.code = 0
    core.jobs._looked(workers)
    assert workers.start.call_count == 1
    assert client.get(f"/v1/jobs/{job_id}").json()["state"] == "running"
    assert client.get(f"/v1/jobs/{job_id}").json()["fault"] is None


def test_a_disk_that_is_nearly_full_is_not_ready(tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "LEAST_FREE_BYTES", 10**18)
    fault = Storage(tmp_path).fault
    assert fault is not None
    assert (fault.status, "MB are free" in str(fault)) == (507, True)


def test_a_full_disk_at_the_client_holds_up_the_receipt_and_nothing_else(
    idle, small_rig, tmp_path, monkeypatch
):
    monkeypatch.setattr(delivery, "FIRST_PAUSE_S", 0.05)
    own = Disk(tmp_path / "mine", monkeypatch)
    path = tmp_path / "mine" / "s.zarr"
    with begun(path, small_rig) as journal:
        journal.append_all(stops(12))
    session = seal(path)
    told: list[str] = []
    own.code = errno.ENOSPC
    sending = Delivery(path, Client(URL, transport=Through(idle()), attempts=1), URL, told.append)
    sending.start()
    until(lambda: told)
    assert "receipt must be writable: No space left on device" in told[0]
    own.code = 0
    assert sending.finish(PATIENCE_S).hash == session.hash
