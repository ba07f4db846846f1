"""Schedules are due when they say, judge each session once and in order, and make up for time without a service once."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import select, update
from starlette.testclient import TestClient

from estimator.service.job_queue import JobQueue
from estimator.service.schedules import next_run
from estimator.service.schema import Job, Schedule, SessionRow
from tests.estimator.service.conftest import begin_session, import_csv, refusal, upload_rig


def schedule(cron: str | None = None, every_s: int | None = None, timezone: str = "UTC") -> Schedule:
    return Schedule(id="s", rig_name="small", cron=cron, every_s=every_s, timezone=timezone)


@pytest.mark.parametrize(
    ("cron", "timezone", "now", "due"),
    [
        ("0 6 * * mon", "UTC", "2026-11-23T05:59:59", "2026-11-23T06:00:00"),
        ("0 6 * * mon", "UTC", "2026-11-23T06:00:00", "2026-11-30T06:00:00"),
        ("0 6 * * *", "Europe/Zurich", "2026-07-01T12:00:00", "2026-07-02T04:00:00"),
        ("30 2 * * *", "Europe/Zurich", "2026-03-28T12:00:00", "2026-03-29T00:30:00"),
        ("*/15 * * * *", "UTC", "2026-12-31T23:50:00", "2027-01-01T00:00:00"),
        ("0 0 29 2 *", "UTC", "2026-11-23T00:00:00", "2028-02-29T00:00:00"),
    ],
)
def test_a_cron_expression_is_due_when_it_says(cron, timezone, now, due):
    at = datetime.fromisoformat(now).replace(tzinfo=UTC)
    found = next_run(schedule(cron=cron, timezone=timezone), at)
    if "30 2" in cron:  # an hour that the clocks leave out: before or after it, and that day
        assert found[:10] == due[:10]
    else:
        assert found == f"{due}.000+00:00"


@pytest.fixture
def client(idle: Callable[..., TestClient]) -> TestClient:
    return idle()


@pytest.fixture
def rig_id(client: TestClient, rig_text: str) -> str:
    return upload_rig(client, rig_text)


@pytest.fixture(scope="module")
def refusing(idle_for_all: Callable[..., TestClient], rig_text: str) -> tuple[TestClient, str]:
    """A service that no test of this module changes, and a rig in it."""
    client = idle_for_all()
    return client, upload_rig(client, rig_text)


def made(client: TestClient, rig_id: str, **more: Any) -> dict[str, Any]:
    answer = client.post("/v1/schedules", json={"rig_id": rig_id, **(more or {"every_s": 3600})})
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


@pytest.mark.parametrize(
    ("body", "thing"),
    [
        ({}, "schedule"),
        ({"cron": "0 6 * * *", "every_s": 60}, "schedule"),
        ({"cron": "0 6 * *"}, "cron"),
        ({"cron": "61 6 * * *"}, "cron"),
        ({"cron": "0 0 30 2 *"}, "cron"),
        ({"cron": "0 6 * * *; rm"}, "cron"),
        ({"cron": "0 6 * * someday"}, "cron"),
        ({"cron": "* " * 60}, "cron"),
        ({"cron": "0 6 * * *", "timezone": "Mars/Olympus"}, "timezone"),
        ({"cron": "0 6 * * *", "timezone": "../../etc/passwd"}, "timezone"),
        ({"every_s": 59}, "every_s"),
        ({"every_s": 10**30}, "every_s"),
        ({"every_s": "60"}, "every_s"),
        ({"every_s": 60, "seed": -1}, "seed"),
    ],
)
def test_what_is_no_schedule_is_refused(refusing, body, thing):
    client, rig_id = refusing
    begin_s = time.monotonic()
    assert refusal(client.post("/v1/schedules", json={"rig_id": rig_id, **body}), 422)["thing"] == thing
    assert time.monotonic() - begin_s < 10
    assert client.get("/v1/schedules").json()["items"] == []


def test_a_schedule_is_made_listed_and_deleted(client, rig_id):
    new = made(client, rig_id, cron="0 6 * * mon", timezone="Europe/Zurich", seed=3)
    assert (new["rig_name"], new["last_run"], new["is_at_work"]) == ("small", None, False)
    assert datetime.fromisoformat(new["next_run"]) > datetime.now(UTC)
    assert client.get("/v1/schedules").json()["items"] == [new]
    assert client.get(f"/v1/schedules/{new['id']}").json() == new
    assert client.delete(f"/v1/schedules/{new['id']}").status_code == 204
    refusal(client.get(f"/v1/schedules/{new['id']}"), 404)
    refusal(client.post("/v1/schedules", json={"rig_id": "0" * 32, "every_s": 60}), 404)


def tick(client: TestClient) -> int:
    return int(client.app.state.core.schedules.tick())


def jobs(client: TestClient) -> list[Job]:
    with client.app.state.core.database.reading() as db:
        return list(db.scalars(select(Job).order_by(Job.number)))


def end_job(client: TestClient, state: str = "done") -> None:
    queue: JobQueue = client.app.state.core.queue
    job = queue.next()
    assert job is not None
    queue.end(job.id, {"state": state, "fault": None if state == "done" else "it broke"})


def sessions(client: TestClient, rig_id: str, csv: bytes, n: int) -> list[str]:
    """Closed sessions, whose instants differ."""
    made = [import_csv(client, rig_id, csv)["id"] for _ in range(n)]
    with client.app.state.core.database.writing() as db:
        for number, session_id in enumerate(made):
            created = f"2026-01-0{n - number}"  # the last one was created first
            db.execute(update(SessionRow).where(SessionRow.id == session_id).values(created=created))
    return made[::-1]


def test_a_run_judges_each_closed_session_once_the_oldest_first_and_one_at_a_time(
    client, rig_id, rig_text, readings_csv
):
    expected = sessions(client, rig_id, readings_csv, 3)
    begin_session(client, rig_id)  # open
    other = upload_rig(client, rig_text.replace("name: small", "name: another"))
    import_csv(client, other, readings_csv)
    newer = upload_rig(client, rig_text + "# another version\n")
    new = made(client, newer)
    assert tick(client) == 0  # not due
    client.post(f"/v1/schedules/{new['id']}/run")
    for number in range(3):
        assert tick(client) == 1
        assert tick(client) == 0  # it waits for the judgement
        job = jobs(client)[-1]
        assert (job.kind, job.session_id, job.rig_id) == ("recalibrate", expected[number], None)
        assert job.options["registry"] == "small"
        assert job.options["settings"].keys() >= {"n_walkers", "target_ess"}
        end_job(client, "failed" if number == 1 else "done")  # one that fails is not tried for ever
    assert client.get(f"/v1/schedules/{new['id']}").json()["is_at_work"]
    assert tick(client) == 0
    after = client.get(f"/v1/schedules/{new['id']}").json()
    assert not after["is_at_work"]
    assert after["last_run"] is not None
    assert datetime.fromisoformat(after["next_run"]) > datetime.now(UTC) + timedelta(minutes=50)
    import_csv(client, rig_id, readings_csv)
    assert tick(client) == 0  # for the next run
    client.post(f"/v1/schedules/{new['id']}/run")
    assert tick(client) == 1
    assert len(jobs(client)) == 4


def test_runs_that_were_missed_are_made_up_for_once(client, rig_id, readings_csv):
    new = made(client, rig_id, cron="0 * * * *")
    long_ago = (datetime.now(UTC) - timedelta(days=3)).isoformat(timespec="milliseconds")
    with client.app.state.core.database.writing() as db:
        db.execute(update(Schedule).values(next_run=long_ago))
    sessions(client, rig_id, readings_csv, 1)
    assert tick(client) == 1
    assert datetime.fromisoformat(client.get(f"/v1/schedules/{new['id']}").json()["next_run"]) > datetime.now(
        UTC
    )
    end_job(client)
    tick(client)
    tick(client)
    assert len(jobs(client)) == 1


def test_two_schedules_of_a_rig_judge_a_session_once(client, rig_id, readings_csv):
    sessions(client, rig_id, readings_csv, 1)
    for new in (made(client, rig_id), made(client, rig_id)):
        client.post(f"/v1/schedules/{new['id']}/run")
    assert tick(client) == 1
    end_job(client)
    assert tick(client) == 0
    assert len(jobs(client)) == 1


def test_a_full_queue_is_waited_for(idle, rig_text, readings_csv):
    client = idle(most_queued=1)
    rig_id = upload_rig(client, rig_text)
    (session,) = sessions(client, rig_id, readings_csv, 1)
    client.post("/v1/jobs/calibrate", json={"session_id": session})
    new = made(client, rig_id)
    client.post(f"/v1/schedules/{new['id']}/run")
    assert tick(client) == 0
    end_job(client)
    assert tick(client) == 1
