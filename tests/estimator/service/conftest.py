"""The service in this process, and in one of its own that can be killed."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from distributed import LocalCluster
from fastapi import FastAPI
from starlette.testclient import TestClient

from estimator.rig.rig import Rig
from estimator.service.app import create_app
from estimator.service.serve import config_of
from estimator.service.settings import Settings
from estimator.service.tokens import Scope, create_token
from estimator.store.importers.readings_csv import write_readings_csv
from estimator.store.session import Session
from tests.program import PROGRAM, ROOT

QUICK = {"n_walkers": 16, "target_ess": 200.0, "largest_rhat": 1.05}
PATIENCE_S = 240
CHROMIUM = shutil.which("chromium")
ON_BREACH = "addEventListener('securitypolicyviolation', (e) => console.error(`policy: ${e.violatedDirective} ${e.blockedURI}`))"
STEPS = 400
YAML, JSON, NDJSON = "application/yaml", "application/json", "application/x-ndjson"
CSV, ZIP = "text/csv", "application/zip"
LONG = {"n_walkers": 16, "target_ess": 1e6, "max_steps": STEPS}  # a chain that a kill meets at work


class Served:
    """A service in a process of its own."""

    def __init__(self, data: Path, *options: object) -> None:
        call = ["serve", "--data", data, "--port", 0, "--workers", 1, *options]
        self.log = data.with_suffix(".log").open("ab")
        self.process = subprocess.Popen(
            [*PROGRAM, *map(str, call)],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=self.log,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline().decode()
        assert " at http" in line, (line, data.with_suffix(".log").read_text(encoding="utf-8"))
        self.url = line.split()[-1]
        self.client = httpx.Client(base_url=self.url, timeout=60)

    def kill(self) -> None:
        """As `kill -9` does."""
        self.process.kill()
        self.process.communicate()

    def end(self) -> int:
        """As `systemctl stop` does; uvicorn ends by the signal itself once everything is closed."""
        self.process.send_signal(signal.SIGTERM)
        self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    """Starts services, and ends those that a test has left."""
    services: list[Served] = []

    def start(*options: object, data: Path = tmp_path / "data") -> Served:
        services.append(Served(data, *options))
        return services[-1]

    yield start
    for service in services:
        service.client.close()
        if service.process.poll() is None:
            service.kill()
        service.log.close()


@contextmanager
def listening(app: FastAPI, settings: Settings, port: int = 0, lifespan: Any = "on") -> Iterator[int]:
    """The application behind uvicorn, as `coilcal serve` has it, in a thread of this process; its port.

    At the end connections are cut, whatever is under way. `lifespan="off"` leaves the application itself alone.
    """
    listener = socket.create_server(("127.0.0.1", port))
    config = config_of(app, settings)
    config.lifespan = lifespan
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    yield int(listener.getsockname()[1])
    server.should_exit = server.force_exit = True
    thread.join(30)
    listener.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as started:
        made = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield made
        made.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A tab in which nothing may go wrong unheard: no fault of a script, nothing that the policy blocks, no dialog."""
    context = browser.new_context(viewport={"width": 1280, "height": 900}, accept_downloads=True)
    context.add_init_script(ON_BREACH)
    tab = context.new_page()
    faults: list[str] = []
    tab.on("pageerror", lambda error: faults.append(str(error)))
    tab.on("console", lambda said: faults.append(said.text) if said.type == "error" else None)
    tab.on("dialog", lambda dialog: (faults.append(f"dialog: {dialog.message}"), dialog.dismiss()))
    tab.set_default_timeout(30_000)
    yield tab
    context.close()
    refused = re.compile(r"the server responded with a status of (401|404|422) ")  # a browser reports each
    assert [fault for fault in faults if not refused.search(fault)] == []


@pytest.fixture(scope="session")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """A service in this process, with a worker that is a thread: one of its own process loads torch for seconds (`Served`)."""
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as workers:
        settings = Settings(
            data=tmp_path_factory.mktemp("service") / "data",
            workers=1,
            scheduler=workers.scheduler_address,
            most_body_MB=2.0,
        )
        with TestClient(
            create_app(settings), base_url="http://127.0.0.1:8765", raise_server_exceptions=False
        ) as client:
            yield client


@pytest.fixture
def url(api: TestClient) -> Iterator[str]:
    """Where the service in this process is reached."""
    with listening(api.app, api.app.state.core.settings, lifespan="off") as port:
        yield f"http://127.0.0.1:{port}"


@pytest.fixture
def idle(tmp_path: Path) -> Iterator[Callable[..., TestClient]]:
    """Makes services in this process that leave jobs in the queue, with settings of one's own."""
    yield from _idle(tmp_path)


@pytest.fixture(scope="module")
def idle_for_all(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., TestClient]]:
    """As `idle`, for tests of a module that leave a service as it was: a new one takes longer than what they ask."""
    yield from _idle(tmp_path_factory.mktemp("idle"))


def _idle(folder: Path) -> Iterator[Callable[..., TestClient]]:
    clients: list[TestClient] = []

    def make(**settings: Any) -> TestClient:
        app = create_app(Settings(data=folder / "data", **settings), has_workers=False)
        client = TestClient(app, base_url="http://127.0.0.1:8765", raise_server_exceptions=False)
        clients.append(client)
        return client.__enter__()

    yield make
    for client in clients:
        client.__exit__(None, None, None)


@pytest.fixture
def filled(
    idle: Callable[..., TestClient], rig_text: str, readings_csv: bytes
) -> Callable[..., tuple[TestClient, str]]:
    """As `idle`, with a closed session, whose id is told."""

    def make(**settings: Any) -> tuple[TestClient, str]:
        client = idle(**settings)
        return client, str(import_csv(client, upload_rig(client, rig_text), readings_csv)["id"])

    return make


@pytest.fixture(scope="session")
def readings_csv(small_session: Session, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("csv") / "readings.csv"
    write_readings_csv(small_session, path)
    return path.read_bytes()


def until(is_so: Callable[[], Any], patience_s: float = 60.0) -> None:
    """Wait for it."""
    end_s = time.monotonic() + patience_s
    while not is_so():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def sent(client: httpx.Client, path: str, body: str | bytes, kind: str, **more: Any) -> httpx.Response:
    return client.post(path, content=body, headers={"Content-Type": kind}, **more)


def upload_rig(client: httpx.Client, text: str) -> str:
    answer = sent(client, "/v1/rigs", text, YAML)
    assert answer.status_code in (200, 201), answer.text
    return str(answer.json()["id"])


def import_csv(client: httpx.Client, rig_id: str, csv: bytes) -> dict[str, Any]:
    answer = sent(client, "/v1/sessions/import-csv", csv, CSV, params={"rig_id": rig_id})
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def send_zip(client: httpx.Client, rig_id: str, archive: bytes) -> httpx.Response:
    return sent(client, "/v1/sessions/import-zip", archive, ZIP, params={"rig_id": rig_id})


def zip_of(files: dict[str, bytes], mode: int = 0, method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in files.items():
            info = zipfile.ZipInfo(name)
            info.external_attr, info.compress_type = mode << 16, method
            archive.writestr(info, content)
    return buffer.getvalue()


def begin_session(client: httpx.Client, rig_id: str) -> str:
    answer = client.post("/v1/sessions", json={"rig_id": rig_id, "source": "a test"})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def lines_of(session: Session, rig: Rig, first: int = 0, last: int | None = None) -> bytes:
    """Readings of a session with one sensor as the service takes them."""
    o = session.observations
    lines = []
    for row in range(first, len(o) if last is None else last):
        lines.append(
            {
                "sequence": row,
                "time_s": float(row),
                "current_A": {c.name: float(o.current_A[row, i]) for i, c in enumerate(rig.coils)},
                "motion": {name: motion[row].tolist() for name, motion in o.motion.items()},
                "field_T": {rig.sensors[0].name: o.field_sensor_T[row].tolist()},
                "is_validation": bool(o.is_validation[row]),
            }
        )
    return b"".join(json.dumps(line).encode() + b"\n" for line in lines)


def numbered(session: Session, rig: Rig, n: int) -> list[bytes]:
    """As many readings as a test wants, a second apart, so many that a kill or a backup falls between them."""
    known = [json.loads(line) for line in lines_of(session, rig).splitlines()]
    return [
        json.dumps({**known[i % len(known)], "sequence": i, "time_s": float(i)}).encode() + b"\n"
        for i in range(n)
    ]


def append(client: httpx.Client, session_id: str, body: bytes) -> httpx.Response:
    return sent(client, f"/v1/sessions/{session_id}/readings", body, NDJSON)


def wait_for(client: httpx.Client, job_id: str) -> dict[str, Any]:
    """The job when it has ended."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        job = dict(client.get(f"/v1/jobs/{job_id}").json())
        if job["state"] not in ("queued", "running"):
            return job
        time.sleep(0.1)
    raise AssertionError(f"job {job_id} takes longer than {PATIENCE_S} s: {job}")


def bearer(client: TestClient, user: str, scope: Scope = Scope.WRITE) -> dict[str, str]:
    """Headers of a new token of a service in this process."""
    secret, _ = create_token(client.app.state.core.database, user, scope, 1.0)
    return {"Authorization": f"Bearer {secret}"}


def steps_of(folder: Path) -> int:
    """Steps that the chain of a job has on disk."""
    try:
        group = json.loads((folder / "calibration" / "chain.zarr" / "zarr.json").read_text(encoding="utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return 0
    return int(group["attributes"]["n_steps"])


def files_of(folder: Path) -> dict[str, bytes]:
    """Calibration of a job: all but what tells of the way there."""
    result = folder / "calibration"
    files = {str(path.relative_to(result)): path.read_bytes() for path in result.rglob("*") if path.is_file()}
    return {name: content for name, content in files.items() if name != "report.html"}


def refusal(answer: httpx.Response, status: int) -> dict[str, Any]:
    """What a refusal says; it has all its parts and no traceback."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = dict(answer.json())
    assert problem["status"] == status
    assert problem["request_id"] == answer.headers["x-request-id"]
    assert "Traceback" not in answer.text
    return problem
