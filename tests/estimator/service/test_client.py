"""The client against a service in a process of its own: the answers of the Python API, also while the service is killed."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import json
import threading
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import httpx
import numpy as np
import pytest
import torch
from starlette.testclient import TestClient

from estimator.calibration.calibrate import calibrate
from estimator.client import (
    AsyncClient,
    AsyncRemoteCalibration,
    AsyncRemoteRegistry,
    AsyncRemoteSession,
    Client,
    JobFailed,
    RemoteCalibration,
    RemoteRegistry,
    RemoteSession,
    ServiceFault,
    connection,
    following,
)
from estimator.client.client import ATTEMPTS
from estimator.client.connection import AsyncConnection, Connection
from estimator.errors import InvalidInput
from estimator.export.request import Grid
from estimator.inference.ensemble import SamplerSettings
from estimator.model.simulate import simulate
from estimator.readings.plan import Plan
from estimator.rig.rig import Rig
from estimator.service.core import Core
from estimator.service.work import PROGRESS
from estimator.store.session import Session
from tests.estimator.service.conftest import QUICK, lines_of, listening

SETTINGS = SamplerSettings(**QUICK)


@pytest.fixture
def interrupted(api: TestClient) -> Iterator[str]:
    """Address of a service that is gone as soon as it has a job, and comes back."""
    core: Core = api.app.state.core
    known = set(core.data.glob("jobs/*"))
    is_done, ports = threading.Event(), SimpleQueue[int]()

    def serve() -> None:
        with listening(api.app, core.settings, lifespan="off") as port:
            ports.put(port)
            while not is_done.is_set() and not begun():
                time.sleep(0.01)
        time.sleep(0.2)
        with listening(api.app, core.settings, port, lifespan="off"):
            is_done.wait()

    def begun() -> bool:
        return any((job / PROGRESS).exists() for job in set(core.data.glob("jobs/*")) - known)

    service = threading.Thread(target=serve)
    service.start()
    yield f"http://127.0.0.1:{ports.get(timeout=30)}"
    is_done.set()
    service.join(60)


@pytest.fixture
def unsent_session(small_rig: Rig, small_plan: Plan, small_truth: dict[str, float]) -> Session:
    """Readings that no other test sends: with equal readings, the service keeps the session that came first."""
    readings = simulate(small_rig, small_plan, small_truth, seed=31)
    return Session(small_rig, readings, "simulated", truth=small_truth)


def test_a_calibration_there_is_read_as_one_here(interrupted, unsent_session, tmp_path):
    """The script does not notice that the service was gone."""
    told: list[Any] = []
    with Client(interrupted) as client:
        there = client.calibrate(unsent_session, seed=2, settings=SETTINGS, on_progress=told.append)
        here = calibrate(unsent_session, seed=2, settings=SETTINGS)
        assert there.summary() == json.loads(json.dumps(here.summary()))
        assert there.best == dict(here.best)
        assert there.rig == here.rig
        assert told[-1]["words"] == "page"
        points_m = torch.tensor([[0.0, 0.0, 0.01], [0.0, 0.049, -0.052]], dtype=torch.float64)
        for method in ("field", "gradient"):
            ours, theirs = (getattr(c, method)(points_m, {"coil1": 2.0}) for c in (here, there))
            assert torch.equal(ours.nan_to_num(7.0), theirs.nan_to_num(7.0)), method
        for method in ("field_interval", "gradient_interval"):
            ours, theirs = (
                torch.stack(getattr(c, method)(points_m, {"coil1": 2.0}, 0.5)) for c in (here, there)
            )
            assert torch.equal(ours.nan_to_num(7.0), theirs.nan_to_num(7.0)), method
        alone_here, alone_there = here.coils_alone(), there.coils_alone()
        ours, theirs = (c.field(points_m, {"coil1": 2.0}) for c in (alone_here, alone_there))
        assert torch.equal(ours.nan_to_num(7.0), theirs.nan_to_num(7.0))
        files = [c.export("json", tmp_path / f"alone{i}") for i, c in enumerate((alone_here, alone_there))]
        assert files[0].read_bytes() == files[1].read_bytes()
        table = there.grid({"coil1": 2.0}, 0.5, x=(0.0, 0.02, 3), has_gradient=True)
        on_grid = torch.tensor([[x, 0.0, 0.0] for x in (0.0, 0.01, 0.02)], dtype=torch.float64)
        upper_T = here.field_interval(on_grid, {"coil1": 2.0}, 0.5)[1]
        assert table.column("Bz_upper_T").to_pylist() == upper_T[:, 2].tolist()
        gradient = here.gradient(on_grid, {"coil1": 2.0})
        assert table.column("dBy_dz_T_per_m").to_pylist() == gradient[:, 1, 2].tolist()
        grid = Grid(np.array([0.0, 0.02]), np.zeros(1), np.zeros(1))
        asked: dict[str, dict[str, Any]] = {"json": {}, "csv": {"grid": grid, "currents_A": {"coil1": 2.0}}}
        for to, beside in asked.items():
            files = [c.export(to, tmp_path / f"{i}" / "file", **beside) for i, c in enumerate((here, there))]
            assert files[0].read_bytes() == files[1].read_bytes()
        with contextlib.chdir(tmp_path):
            assert there.export("cpp") == here.export("cpp") == Path("coilcal_small.hpp")
        assert client.calibration(there.id).summary() == there.summary()
        with pytest.raises(InvalidInput, match="coil9"):
            there.field(points_m, {"coil9": 1.0})
        first = client.upload(unsent_session)
        assert client.upload(replace(unsent_session, source="sent again")) == first


@pytest.mark.slow
def test_sessions_are_judged_designed_for_and_fitted_together_there(served, small_session, small_rig):
    service = served()
    with Client(service.url) as client:
        entry = client.recalibrate(small_session, seed=2, settings=SETTINGS)
        assert (entry.conclusion, entry.version, entry.made) == ("updated", 1, 1)
        registry = client.registry(small_rig)
        assert registry.current == 1
        assert registry.calibration().summary()["session_hash"] == small_session.hash
        assert [version["version"] for version in registry.versions()] == [1]
        assert [item["session_id"] for item in registry.entries()] == [entry.session]
        with pytest.raises(InvalidInput, match="another than the one in use"):
            registry.roll_back(1)
        found = client.batch([small_session], hypotheses=["plain", "axis_gain"], has_posterior=False)
        assert [fit["hypothesis"] for fit in found["fits"]] == ["plain", "axis_gain"]
        plan = client.design(small_session, shrink="coil1.radius_m", n_readings=2)
        assert len(plan["reached"]) == 2
        assert len(list(client.pages("/v1/jobs", limit=1))) == 3


def test_readings_are_streamed_and_a_job_that_fails_says_why(api, url, small_session, small_rig):
    readings = [json.loads(line) for line in lines_of(small_session, small_rig).splitlines()]
    with Client(url) as client:
        session = client.begin(small_rig, "a stream")
        assert [session.append(readings[:20]), session.append(readings[10:])] == [20, len(readings)]
        session.close()
        fixed = small_rig.with_fixed([p.name for p in small_rig.free if not p.is_count])
        with pytest.raises(JobFailed, match="must have a free parameter besides loop counts"):
            client.calibrate(small_session, fixed)

    async def awaited() -> None:
        async with AsyncClient(url) as client:
            session = await client.begin(small_rig, "a stream", key="second")
            assert (await client.begin(small_rig, "a stream", key="second")).id == session.id
            assert await session.append(readings) == len(readings)
            assert (await session.label({"name": "Coil 7", "tags": ["cold"]}))["tags"] == ["cold"]
            assert (await session.close())["state"] == (await session.info())["state"] == "closed"
            with pytest.raises(JobFailed, match="must have a free parameter besides loop counts"):
                await client.calibrate(small_session, fixed)
            jobs = [job["id"] async for job in client.pages("/v1/jobs", limit=1)]
            assert jobs == [job["id"] for job in api.get("/v1/jobs", params={"limit": 500}).json()["items"]]

    asyncio.run(awaited())


def test_a_service_that_is_not_there_is_said_in_words(monkeypatch, small_session):
    monkeypatch.setattr(connection, "FIRST_PAUSE_S", 0.001)
    sentence = "service must answer; http://127.0.0.1:9"
    with Client("http://127.0.0.1:9") as client, pytest.raises(ServiceFault, match=sentence):
        client.calibrate(small_session)

    async def there() -> None:
        async with AsyncClient("http://127.0.0.1:9") as client:
            await client.calibrate(small_session)

    with pytest.raises(ServiceFault, match=sentence):
        asyncio.run(there())


def test_of_coils_alone_every_prediction_and_export_is_asked_so(tmp_path):
    asked: list[dict[str, Any]] = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(json.loads(request.content))
        names = ("field_T", "field_lower_T", "field_upper_T", "gradient_T_per_m")
        told = {key: [[0.0] * 3] for key in (*names, "gradient_lower_T_per_m", "gradient_upper_T_per_m")}
        return httpx.Response(200, json=told, headers={"Content-Disposition": 'filename="model"'})

    there = Client("http://service", transport=httpx.MockTransport(answer))
    whole = RemoteCalibration("c", {}, there.connection)
    points_m = torch.zeros(1, 3, dtype=torch.float64)
    for calibration, words in ((whole, {None}), (whole.coils_alone(), {True})):
        asked.clear()
        for name in ("field", "gradient", "field_interval", "gradient_interval"):
            getattr(calibration, name)(points_m, {"coil1": 1.0})
        calibration.export("json", tmp_path / "model")
        assert {body.get("is_of_coils_alone") for body in asked} == words
        assert len(asked) == 5


MIRRORED = [
    (Client, AsyncClient),
    (RemoteCalibration, AsyncRemoteCalibration),
    (RemoteRegistry, AsyncRemoteRegistry),
    (RemoteSession, AsyncRemoteSession),
]


@pytest.mark.parametrize(("waits", "awaits"), MIRRORED)
def test_what_is_awaited_has_the_parameters_of_what_waits(waits, awaits):
    """What is a property where it waits is a method where it is awaited, for attributes cannot be awaited well."""
    names, mirrored = ({name for name in dir(kind) if not name.startswith("_")} for kind in (waits, awaits))
    assert names == mirrored
    for name in names:
        here, there = (getattr(kind, name) for kind in (waits, awaits))
        if callable(here):
            parameters = [list(inspect.signature(method).parameters.values()) for method in (here, there)]
            assert [(p.name, p.kind, p.default) for p in parameters[0]] == [
                (p.name, p.kind, p.default) for p in parameters[1]
            ], name


def test_a_stream_that_breaks_goes_on_after_the_last_event(monkeypatch):
    """Each answer ends inside an event, which is told once, when it comes whole."""
    monkeypatch.setattr(following, "LOOK_EVERY_S", 0.0)
    streams = [b"id: 1\ndata: 1\n\nid: 2\nevent: end\n", b"id: 2\ndata: 2\n\nevent: end\n\n"]
    asked: list[str] = []

    def answer(request: httpx.Request) -> httpx.Response:
        if request.url.path.endswith("/events"):
            asked.append(request.headers["Last-Event-ID"])
            return httpx.Response(200, stream=Broken(streams[len(asked) - 1]))
        return httpx.Response(200, json={"id": "j", "state": "done"})

    waits = Connection("http://service", None, httpx.MockTransport(answer), 1)
    told: list[Any] = []
    waits.run(following.result_of(waits, "calibrate", {}, told.append))
    assert (asked, told) == (["0", "1"], [1, 2])
    asked.clear()

    async def there() -> None:
        awaits = AsyncConnection("http://service", None, httpx.MockTransport(answer), 1)
        await following.result_of(awaits, "calibrate", {}, told.append)
        await awaits.close()

    asyncio.run(there())
    assert (asked, told) == (["0", "1"], [1, 2, 1, 2])


class Broken(httpx.SyncByteStream, httpx.AsyncByteStream):
    """A body after which the connection breaks."""

    def __init__(self, content: bytes) -> None:
        self.content = content

    def __iter__(self) -> Iterator[bytes]:
        yield self.content
        raise httpx.ReadError("broken")

    async def __aiter__(self) -> AsyncIterator[bytes]:
        yield self.content
        raise httpx.ReadError("broken")


def test_a_service_that_is_busy_is_asked_again_when_it_says(monkeypatch):
    pauses_s: list[float] = []
    monkeypatch.setattr("time.sleep", pauses_s.append)
    busy = {"status_code": 429, "json": {"detail": "queue must have room"}}
    answers = [
        httpx.Response(**busy, headers={"Retry-After": "3"}),
        httpx.Response(**busy, headers={"Retry-After": "9999"}),
        httpx.Response(503),
        httpx.Response(200, json={"id": "x"}),
    ]
    with Client("http://service", transport=httpx.MockTransport(lambda _: answers.pop(0))) as client:
        assert client.request("GET", "/v1/state").json() == {"id": "x"}
        assert pauses_s == [3.0, connection.LONGEST_PAUSE_S, 4 * connection.FIRST_PAUSE_S]
        answers += [httpx.Response(**busy)] * ATTEMPTS
        with pytest.raises(ServiceFault, match="queue must have room"):
            client.request("GET", "/v1/state")
        assert answers == []
        answers.append(httpx.Response(422, json={"detail": "seed must be >= 0"}))
        with pytest.raises(InvalidInput, match="seed must be >= 0"):
            client.request("GET", "/v1/state")
        answers.append(httpx.Response(500, content=b"<html>"))
        with pytest.raises(ServiceFault, match="service must answer as coilcal does; it says 500"):
            client.request("GET", "/v1/state")


def test_a_pause_that_is_awaited_lets_others_go_on():
    answers, order = [httpx.Response(503), httpx.Response(200, json={})], []

    async def there() -> None:
        async def asks() -> None:
            await client.request("GET", "/v1/state")
            order.append("asks")

        async def waits() -> None:
            order.append("waits")

        transport = httpx.MockTransport(lambda _: answers.pop(0))
        async with AsyncClient("http://service", transport=transport) as client:
            await asyncio.gather(asks(), waits())

    asyncio.run(there())
    assert order == ["waits", "asks"]
