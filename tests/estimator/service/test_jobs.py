"""Jobs from the request to the result: the same numbers as the Python API gives, and one queue that is fair."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from sqlalchemy import select
from starlette.testclient import TestClient

from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.service import dispatcher as dispatcher_module
from estimator.service.database import now
from estimator.service.dispatcher import Dispatcher
from estimator.service.job_queue import JobQueue
from estimator.service.schema import Job
from estimator.service.tasks import TASKS, AssignedJob
from estimator.service.work import RESULT, STOP
from estimator.store.session import Session
from tests.estimator.service.conftest import QUICK, import_csv, refusal, upload_rig, wait_for

WHAT_WORKS = {
    "calibrate": "estimator.calibration.calibrate.calibrate",
    "batch": "estimator.batching.batch",
    "diagnose": "estimator.diagnosis.diagnose.diagnose",
}


@pytest.fixture(scope="module")
def session_id(api: TestClient, rig_text: str, readings_csv: bytes) -> str:
    return str(import_csv(api, upload_rig(api, rig_text), readings_csv)["id"])


@pytest.fixture(scope="module")
def job(api: TestClient, session_id: str) -> dict[str, Any]:
    body = {"session_id": session_id, "seed": 3, "settings": QUICK}
    answer = api.post("/v1/jobs/calibrate", json=body, headers={"Idempotency-Key": "first"})
    assert answer.status_code == 201, answer.text
    again = api.post("/v1/jobs/calibrate", json=body, headers={"Idempotency-Key": "first"})
    assert (again.status_code, again.json()["id"]) == (200, answer.json()["id"])
    other = api.post("/v1/jobs/calibrate", json={**body, "seed": 4}, headers={"Idempotency-Key": "first"})
    assert "one job" in refusal(other, 409)["rule"]
    return wait_for(api, answer.json()["id"])


@pytest.fixture(scope="module")
def result(api: TestClient, job: dict[str, Any]) -> dict[str, Any]:
    assert (job["state"], job["fault"], job["starts"]) == ("done", None, 1)
    return dict(api.get(f"/v1/jobs/{job['id']}/result").json())


@pytest.fixture(scope="module")
def in_process(small_session: Session) -> Calibration:
    return calibrate(small_session, seed=3, settings=SamplerSettings(**QUICK))


def test_a_calibration_has_the_numbers_of_the_python_api(result, in_process, api):
    assert result["result"]["parameters"] == json.loads(json.dumps(in_process.summary()["parameters"]))
    summary = api.get(f"/v1/calibrations/{result['calibration_id']}/summary")
    assert summary.json() == result["result"]
    tag = {"If-None-Match": summary.headers["etag"]}
    again = api.get(f"/v1/calibrations/{result['calibration_id']}/summary", headers=tag)
    assert (again.status_code, again.content) == (304, b"")
    intervals = api.get(f"/v1/calibrations/{result['calibration_id']}/intervals").json()
    assert intervals["best"] == dict(in_process.best)
    assert summary.headers["content-encoding"] == "gzip"


def test_the_report_runs_nothing(job, api):
    page = api.get(f"/v1/jobs/{job['id']}/report")
    assert page.headers["content-type"].startswith("text/html")
    assert "Calibration of small" in page.text
    assert "script-src" not in page.headers["content-security-policy"]
    assert "default-src 'none'" in page.headers["content-security-policy"]


def test_events_tell_the_progress_once_and_end_with_the_job(job, api):
    def events(**headers: str) -> list[dict[str, str]]:
        text = api.get(f"/v1/jobs/{job['id']}/events", headers=headers).text
        blocks = [block for block in text.strip().split("\n\n") if not block.startswith(":")]
        return [dict(line.split(": ", 1) for line in block.splitlines()) for block in blocks]

    told = events()
    assert told[-1]["event"] == "end"
    assert json.loads(told[-1]["data"])["state"] == "done"
    progress = [json.loads(event["data"]) for event in told[:-1]]
    assert progress[0]["words"].startswith("point estimate")
    assert any("smallest_ess" in line for line in progress)
    assert [int(event["id"]) for event in told[:-1]] == list(range(1, len(told)))
    assert events(**{"Last-Event-ID": "2"}) == told[2:]


def test_a_job_that_cannot_be_done_says_why(api, rig_text, readings_csv):
    fixed = rig_text.replace("{prior: {normal: {mean: 51, sd: 1}}}", "51")
    fixed = fixed.replace("{prior: {normal: {mean: -40, sd: 3}}}", "-40")
    session = import_csv(api, upload_rig(api, fixed), readings_csv)
    answer = api.post("/v1/jobs/calibrate", json={"session_id": session["id"]})
    job = wait_for(api, answer.json()["id"])
    assert job["state"] == "failed"
    assert job["fault"].startswith("rig must have a free parameter besides loop counts")
    assert "done" in refusal(api.get(f"/v1/jobs/{job['id']}/result"), 409)["rule"]


def test_a_running_job_is_cancelled_and_its_worker_takes_the_next(api, session_id):
    endless = {"n_walkers": 16, "target_ess": 1e6, "max_steps": 1_000_000}
    first = api.post("/v1/jobs/calibrate", json={"session_id": session_id, "settings": endless}).json()
    while api.get(f"/v1/jobs/{first['id']}").json()["state"] == "queued":
        pass
    cancelled = api.post(f"/v1/jobs/{first['id']}/cancel").json()
    assert cancelled["state"] == "cancelled"
    assert api.post(f"/v1/jobs/{first['id']}/cancel").json() == cancelled
    short = {"n_walkers": 16, "max_steps": 20}
    second = api.post("/v1/jobs/calibrate", json={"session_id": session_id, "settings": short}).json()
    assert wait_for(api, second["id"])["state"] == "done"
    assert api.get(f"/v1/jobs/{first['id']}").json()["state"] == "cancelled"


def test_lists_come_in_pages(api, session_id, job):  # noqa: ARG001
    whole = api.get("/v1/jobs", params={"limit": 100}).json()
    assert whole["next"] is None
    collected: list[dict[str, Any]] = []
    cursor: str | None = None
    while not collected or cursor is not None:
        page = api.get("/v1/jobs", params={"limit": 1, "cursor": cursor} if cursor else {"limit": 1}).json()
        collected += page["items"]
        cursor = page["next"]
    assert collected == whole["items"]
    assert [item["id"] for item in api.get("/v1/calibrations").json()["items"]]
    assert refusal(api.get("/v1/jobs", params={"cursor": "what"}), 422)["thing"] == "cursor"


def test_a_diagnosis_gives_a_verdict_and_the_extended_rig(api, session_id):
    body = {"session_id": session_id, "most_causes": 0, "minutes": 1}
    answer = api.post("/v1/jobs/diagnose", json=body)
    job = wait_for(api, answer.json()["id"])
    assert (job["state"], job["fault"]) == ("done", None)
    result = api.get(f"/v1/jobs/{job['id']}/result").json()
    assert result["result"]["verdict"] in ("named", "indistinguishable", "unexplained", "nothing_found")
    assert "schema_version: 1" in result["extended_rig"]
    report = api.get(f"/v1/jobs/{job['id']}/report")
    assert "Diagnosis" in report.text
    tag = {"If-None-Match": report.headers["etag"]}
    again = api.get(f"/v1/jobs/{job['id']}/report", headers=tag)
    policy = "content-security-policy"
    assert (again.status_code, again.headers[policy]) == (304, report.headers[policy])
    panels = api.get(f"/v1/jobs/{job['id']}/panels")
    assert panels.json()["verdict"] == result["result"]["verdict"]
    tag = {"If-None-Match": panels.headers["etag"]}
    assert api.get(f"/v1/jobs/{job['id']}/panels", headers=tag).status_code == 304


# The queue


@pytest.fixture
def queue(filled: Callable[..., tuple[TestClient, str]]) -> tuple[TestClient, str]:
    return filled(most_queued=4, most_queued_per_user=3, most_running_per_user=2)


def add(client: TestClient, session_id: str, user: str) -> Job:
    queue: JobQueue = client.app.state.core.queue
    job = {"kind": "calibrate", "user": user, "session_id": session_id, "rig_id": None, "options": {}}
    with client.app.state.core.database.writing() as db:
        return queue.add(db, {**job, "idempotency_key": None})[0]


def test_a_full_queue_says_when_to_ask_again(queue):
    client, session_id = queue
    for _ in range(3):
        assert client.post("/v1/jobs/calibrate", json={"session_id": session_id}).status_code == 201
    answer = client.post("/v1/jobs/calibrate", json={"session_id": session_id})
    assert refusal(answer, 429)["thing"] == "queue of local"
    assert int(answer.headers["retry-after"]) > 0
    add(client, session_id, "anne")
    answer = client.post("/v1/jobs/calibrate", json={"session_id": session_id})
    assert refusal(answer, 429)["thing"] == "queue"


def test_users_take_turns_and_none_has_more_than_its_share(filled):
    client, session_id = filled(most_running_per_user=2)
    for user in ("anne", "anne", "anne", "bo"):
        add(client, session_id, user)
    queue: JobQueue = client.app.state.core.queue
    begun = [queue.next() for _ in range(4)]
    assert [None if job is None else job.user for job in begun] == ["anne", "bo", "anne", None]
    queue.end(begun[0].id, {"state": "failed", "fault": "x"})
    assert queue.next().number == 3
    assert now() >= begun[0].created


def test_what_ran_when_the_service_ended_goes_on_first(queue):
    client, session_id = queue
    add(client, session_id, "anne"), add(client, session_id, "bo")
    jobs: JobQueue = client.app.state.core.queue
    begun = jobs.next()
    jobs.take_back()
    again = jobs.next()
    assert (again.id, again.starts) == (begun.id, 2)


class Workers:
    """Stands for a cluster: calls never end, and to stop one takes until `go`."""

    def __init__(self) -> None:
        self.go, self.stopping, self.calls = threading.Event(), threading.Event(), []

    def start(self, call: Any, on_end: Callable[[], None]) -> Any:
        self.calls.append(call)
        return SimpleNamespace(status="pending")

    def stop(self, future: Any) -> None:
        self.stopping.set()
        self.go.wait(30)
        future.status = "cancelled"


def test_other_jobs_start_while_a_cancelled_one_ends(filled, monkeypatch):
    """A worker that does not look up has to be replaced, which takes seconds; its place is taken for so long."""
    monkeypatch.setattr(dispatcher_module, "GRACE_S", 0.0)
    (client, session_id), workers = filled(workers=3), Workers()
    jobs: Dispatcher = client.app.state.core.jobs
    ids = [add(client, session_id, "local").id for _ in range(2)]

    def states() -> list[str]:
        return [client.get(f"/v1/jobs/{job_id}").json()["state"] for job_id in ids]

    jobs._look(workers)
    assert states() == ["running", "running"]
    client.post(f"/v1/jobs/{ids[0]}/cancel")
    jobs._look(workers)
    assert workers.stopping.wait(30)
    ids += [add(client, session_id, "local").id for _ in range(2)]
    jobs._look(workers)
    assert states() == ["cancelled", "running", "running", "queued"]
    workers.go.set()
    for thread in jobs._ending:
        thread.join(30)
    jobs._look(workers)
    assert states() == ["cancelled", "running", "running", "running"]


def test_a_job_that_ends_by_itself_when_cancelled_keeps_its_worker(filled):
    (client, session_id), workers = filled(workers=1), Workers()
    jobs: Dispatcher = client.app.state.core.jobs
    job_id = add(client, session_id, "local").id
    jobs._look(workers)
    client.post(f"/v1/jobs/{job_id}/cancel")
    running = jobs._running[job_id]
    jobs._look(workers)
    assert (jobs.folder(job_id) / STOP).exists()
    running.future.status = "finished"
    for thread in jobs._ending:
        thread.join(30)
    assert not workers.stopping.is_set()


@pytest.mark.parametrize(
    ("result", "words"),
    [(b"", "result.json must be JSON"), (b"[", "result.json must be JSON"), (None, "it ended with")],
)
def test_a_job_without_a_whole_result_fails_and_others_go_on(filled, result, words):
    (client, session_id), workers = filled(workers=2), Workers()
    jobs: Dispatcher = client.app.state.core.jobs
    damaged, other = (add(client, session_id, "local").id for _ in range(2))
    jobs._look(workers)
    if result is not None:
        (jobs.folder(damaged) / RESULT).write_bytes(result)
    jobs._running[damaged].future.status = "finished"
    jobs._look(workers)
    state = client.get(f"/v1/jobs/{damaged}").json()
    assert (state["state"], client.get(f"/v1/jobs/{other}").json()["state"]) == ("failed", "running")
    assert state["fault"].startswith(f"job must end with a result; {words}")


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        ("calibrate", {"as_described": True}, "--as-described"),
        ("batch", {"as_described": True}, "--as-described"),
        ("diagnose", {"has_corrections": False}, "--no-corrections"),
    ],
)
def test_a_job_does_as_the_command_does_with_the_same_option(filled, monkeypatch, kind, options, words):
    (client, session_id), heard = filled(), dict[str, Any]()

    def listen(*_: object, **given: Any) -> None:
        heard.update(given)
        raise InvalidInput("heard")

    monkeypatch.setattr(WHAT_WORKS[kind], listen)
    which = {"session_ids": [session_id]} if kind == "batch" else {"session_id": session_id}
    for given in ({}, options):
        job_id = client.post(f"/v1/jobs/{kind}", json={**which, **given}).json()["id"]
        core = client.app.state.core
        with core.database.reading() as db:
            row = db.scalar(select(Job).where(Job.id == job_id))
        path = core.sessions.path(session_id)
        content = {"id": job_id, "options": row.options, "rig": None, "sessions": [str(path)]}
        job = AssignedJob(content, core.jobs.folder(job_id), path, lambda *_: None)
        with pytest.raises(InvalidInput, match="heard"):
            TASKS[kind].work(job)
        ((name, value),) = options.items()
        assert heard[name] is (value if given else not value)
        assert (words in job.command(kind)) is bool(given)
