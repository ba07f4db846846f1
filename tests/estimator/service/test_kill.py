"""kill -9 of the service in the middle of an append and of jobs: nothing that was acknowledged is lost, and results are the same."""

from __future__ import annotations

import json
import signal
import threading
import time
from pathlib import Path

import httpx
import pytest

from estimator.store.session import load_session
from tests.estimator.service.conftest import (
    LONG,
    STEPS,
    Served,
    append,
    begin_session,
    files_of,
    import_csv,
    numbered,
    steps_of,
    upload_rig,
    wait_for,
)


def test_acknowledged_readings_are_there_once_after_a_kill_and_streams_end_with_the_service(
    served, rig_text, small_session, small_rig, tmp_path
):
    lines = numbered(small_session, small_rig, 5000)
    service = served()
    client = service.client
    session_id = begin_session(client, upload_rig(client, rig_text))
    acknowledged = 0

    def send() -> None:
        nonlocal acknowledged
        try:
            for first in range(0, len(lines), 20):
                answer = append(client, session_id, b"".join(lines[first : first + 20]))
                acknowledged = answer.json()["n_readings"]
        except httpx.TransportError:
            pass

    sender = threading.Thread(target=send)
    sender.start()
    while acknowledged < 200:
        time.sleep(0.001)
    service.kill()
    sender.join()
    assert 200 <= acknowledged < len(lines)

    service = served()
    client = service.client
    n = client.get(f"/v1/sessions/{session_id}").json()["n_readings"]
    assert acknowledged <= n <= acknowledged + 20
    first = max(0, acknowledged - 20)
    answer = append(
        client, session_id, b"".join(lines[first : first + 60])
    )  # what a client would send again, and more
    assert answer.json() == {"n_readings": first + 60, "n_new": first + 60 - n}
    closed = client.post(f"/v1/sessions/{session_id}/close").json()
    stored = load_session(tmp_path / "data" / "sessions" / f"{session_id}.zarr").observations
    assert stored.time_s.tolist() == [float(i) for i in range(first + 60)]
    expected = [json.loads(line)["field_T"]["hall"] for line in lines[: first + 60]]
    assert stored.field_sensor_T.tolist() == expected
    assert closed["n_readings"] == first + 60
    design = client.post("/v1/jobs/design", json={"session_id": session_id}).json()["id"]
    assert wait_for(client, design)["fault"].startswith("a design must split")  # says a worker process
    event_streams_end_with(service, begin_session(client, upload_rig(client, rig_text)), tmp_path)


def event_streams_end_with(service: Served, session_id: str, folder: Path) -> None:
    """Else uvicorn waits for them until its patience is over, and logs each as a fault."""
    with service.client.stream("GET", f"/v1/sessions/{session_id}/live") as stream:
        lines = stream.iter_lines()
        next(lines)
        assert service.end() == -signal.SIGTERM
        for _ in lines:
            pass
    assert '"ERROR"' not in (folder / "data.log").read_text(encoding="utf-8")


@pytest.mark.slow
def test_jobs_end_after_kills_with_the_bytes_of_those_that_were_let_alone(
    served, rig_text, readings_csv, tmp_path
):
    service = served()
    client = service.client
    session = import_csv(client, upload_rig(client, rig_text), readings_csv)
    body = {"session_id": session["id"], "seed": 5, "settings": LONG}

    def ask() -> str:
        return str(client.post("/v1/jobs/calibrate", json=body).json()["id"])

    killed, waiting = ask(), ask()
    folder = tmp_path / "data" / "jobs" / killed
    for n_steps in (100, 200):  # a kill at each
        while steps_of(folder) < n_steps:
            time.sleep(0.005)
        service.kill()
        assert not (folder / "result.json").exists()
        service = served()
        client = service.client
    job, other = wait_for(client, killed), wait_for(client, waiting)
    assert (job["state"], job["starts"]) == ("done", 3)
    assert (other["state"], other["starts"]) == ("done", 1)
    survived, alone = (files_of(tmp_path / "data" / "jobs" / job_id) for job_id in (killed, waiting))
    assert survived.keys() == alone.keys()
    assert [name for name in alone if survived[name] != alone[name]] == []
    results = [client.get(f"/v1/jobs/{job_id}/result").json()["result"] for job_id in (killed, waiting)]
    assert results[0] == results[1]
    assert results[0]["sampling"]["steps"] == STEPS
    service.end()
