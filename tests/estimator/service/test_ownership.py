"""What one user makes, another one reads and does not change: tried on every route of the schema, and found in the audit log."""

from __future__ import annotations

import errno
import hashlib
import json
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from fastapi import APIRouter
from sqlalchemy import select, text
from starlette.testclient import TestClient

from estimator.recalibration.registry import Registry
from estimator.rig.rig import Rig
from estimator.service import guard, rate_limits
from estimator.service.app import create_app
from estimator.service.core import Core
from estimator.service.job_queue import DONE
from estimator.service.requests import Id, Writer
from estimator.service.routes import operation, registries, schedules
from estimator.service.schema import Audit, Base, CalibrationRow, Job
from estimator.service.settings import Settings
from estimator.service.tokens import Scope, create_token, revoke_token
from estimator.store.session import Session
from tests.estimator.service.conftest import (
    CSV,
    ZIP,
    bearer,
    begin_session,
    import_csv,
    lines_of,
    refusal,
    upload_rig,
)

NEW, READS, OWN, ADMIN, SELF = "makes something of one's own", "changes nothing", "owner", "admin", "oneself"
EXPORT = "/v1/calibrations/{calibration_id}"
# Of every method and path that is no GET: whom it is for. A route that is not here fails the test.
RULES = {
    ("POST", "/v1/login"): SELF,
    ("POST", "/v1/logout"): SELF,
    ("POST", "/v1/rigs"): NEW,
    ("POST", "/v1/rigs/validate"): READS,
    ("POST", "/v1/rigs/{rig_id}/registry/roll-back"): OWN,
    ("POST", "/v1/sessions"): NEW,
    ("POST", "/v1/sessions/import-csv"): NEW,
    ("POST", "/v1/sessions/import-zip"): NEW,
    ("POST", "/v1/sessions/{session_id}/readings"): OWN,
    ("POST", "/v1/sessions/{session_id}/close"): OWN,
    ("POST", "/v1/sessions/{session_id}/next"): READS,
    ("POST", "/v1/sessions/preview-csv"): READS,
    ("PATCH", "/v1/sessions/{session_id}"): OWN,
    ("PATCH", "/v1/jobs/{job_id}"): OWN,
    ("DELETE", "/v1/sessions/{session_id}"): OWN,
    ("POST", "/v1/jobs/calibrate"): NEW,
    ("POST", "/v1/jobs/diagnose"): NEW,
    ("POST", "/v1/jobs/batch"): NEW,
    ("POST", "/v1/jobs/design"): NEW,
    ("POST", "/v1/jobs/recalibrate"): OWN,
    ("POST", "/v1/jobs/{job_id}/cancel"): OWN,
    ("DELETE", "/v1/jobs/{job_id}"): OWN,
    ("POST", "/v1/schedules"): OWN,
    ("POST", "/v1/schedules/{schedule_id}/run"): OWN,
    ("DELETE", "/v1/schedules/{schedule_id}"): OWN,
    ("POST", "/v1/webhooks"): ADMIN,
    ("DELETE", "/v1/webhooks/{webhook_id}"): ADMIN,
    ("POST", "/v1/webhooks/{webhook_id}/test"): ADMIN,
    **{("POST", f"{EXPORT}/{name}"): READS for name in ("predict", "predict.arrow", "grid", "grid.arrow", "export")},
}  # fmt: skip


def changing(client: TestClient) -> set[tuple[str, str]]:
    paths = client.app.openapi()["paths"]
    return {(m.upper(), path) for path, item in paths.items() for m in item if m not in ("get", "head")}


class Bench:
    """A service with what Anne has made, and requests that would change it."""

    def __init__(self, client: TestClient, rig_text: str, csv: bytes, readings: bytes) -> None:
        self.client, self.core = client, client.app.state.core
        self.users = {user: bearer(client, user) for user in ("anne", "bert")}
        self.users["root"] = bearer(client, "root", Scope.ADMIN)
        client.headers.update(self.users["anne"])
        self.rig_id = upload_rig(client, rig_text)
        self.open_id = begin_session(client, self.rig_id)
        self.lines = readings.splitlines(keepends=True)
        self.closed_id, self.spare_id = (import_csv(client, self.rig_id, csv)["id"] for _ in range(2))
        self.job_id, self.ended_id = (self._job() for _ in range(2))
        with self.core.database.writing() as db:
            job = db.scalars(select(Job).where(Job.id == self.ended_id)).one()
            job.state, job.ended = DONE, "2026-01-01"
        body = {"rig_id": self.rig_id, "every_s": 60}
        self.schedule_id = client.post("/v1/schedules", json=body).json()["id"]
        hook = client.post("/v1/webhooks", json={"url": "https://a.example"}, headers=self.users["root"])
        self.webhook_id = hook.json()["id"]
        client.headers.pop("Authorization")

    def _job(self) -> str:
        return str(self.client.post("/v1/jobs/calibrate", json={"session_id": self.closed_id}).json()["id"])

    def ask(self, method: str, path: str, user: str) -> Any:
        ids = {"rig_id": self.rig_id, "session_id": self.open_id, "schedule_id": self.schedule_id}
        ids |= {
            "job_id": self.job_id if path.endswith("cancel") else self.ended_id,
            "webhook_id": self.webhook_id,
        }
        if method == "DELETE":
            ids["session_id"] = self.spare_id
        call: dict[str, Any] = {"headers": dict(self.users[user])}
        if method == "PATCH":
            call["json"] = {"name": f"as {user} calls it"}
        elif path.endswith("/readings"):
            call["content"] = self.lines[0]
            call["headers"]["Content-Type"] = "application/x-ndjson"
        elif path.endswith("/roll-back"):
            call["json"] = {"version": 1}
        elif path == "/v1/schedules":
            call["json"] = {"rig_id": self.rig_id, "every_s": 60}
        elif path == "/v1/webhooks":
            call["json"] = {"url": "https://b.example"}
        elif path.startswith("/v1/jobs/") and "{" not in path:
            key = "session_ids" if path.endswith("batch") else "session_id"
            call["json"] = {key: [self.closed_id] if key == "session_ids" else self.closed_id}
            call["json"] |= {"shrink": "coil1.radius"} if path.endswith("design") else {}
        return self.client.request(method, path.format(**ids), **call)

    def state(self) -> dict[str, str]:
        """Digests of all tables but the audit log, and of all files but the database."""
        found = {}
        with self.core.database.reading() as db:
            for table in Base.metadata.sorted_tables:
                if table.name != Audit.__tablename__:
                    rows = sorted(map(str, db.execute(text(f"SELECT * FROM {table.name}")).all()))
                    found[table.name] = hashlib.sha256(json.dumps(rows).encode()).hexdigest()
        data: Path = self.core.data
        for path in data.rglob("*"):
            if path.is_file() and not path.name.startswith("coilcal.sqlite"):
                found[str(path.relative_to(data))] = hashlib.sha256(path.read_bytes()).hexdigest()
        return found

    def audit(self) -> list[Audit]:
        with self.core.database.reading() as db:
            return list(db.scalars(select(Audit).order_by(Audit.number)))


@pytest.fixture
def bench(
    idle: Callable[..., TestClient],
    rig_text: str,
    readings_csv: bytes,
    small_session: Session,
    small_rig: Rig,
) -> Bench:
    return Bench(idle(require_tokens=True), rig_text, readings_csv, lines_of(small_session, small_rig))


def test_every_route_that_changes_something_is_classified(bench):
    assert changing(bench.client) == set(RULES)


def test_nobody_changes_what_another_user_has_made_and_who_tried_is_noted(bench):
    before = bench.state()
    for (method, path), rule in RULES.items():
        if rule not in (OWN, ADMIN):
            continue
        n = len(bench.audit())
        told = refusal(bench.ask(method, path, "bert"), 403)
        assert told["rule"].startswith("must be one's own" if rule == OWN else "must have the scope admin"), (
            path
        )
        (entry,) = bench.audit()[n:]
        assert (entry.user, entry.action, entry.request_id) == ("bert", "refused", told["request_id"])
        assert re.fullmatch(f"{method} {re.sub('{.*?}', '[0-9a-f]+', path)}", entry.target)
        assert entry.token_id is not None
    assert bench.state() == before


@pytest.mark.parametrize("user", ["anne", "root"])
def test_the_owner_and_an_admin_change_it_and_each_change_is_noted(bench, user):
    order = sorted((key for key, rule in RULES.items() if rule == OWN), key=lambda key: key[0] == "DELETE")
    order.sort(key=lambda key: key[1].endswith("/close"))
    for method, path in order:
        n = len(bench.audit())
        answer = bench.ask(method, path, user)
        if path.endswith("/roll-back"):
            assert "must have a version" in refusal(answer, 409)["rule"]  # and so nothing was changed
            continue
        assert answer.is_success, (path, answer.text)
        (entry,) = bench.audit()[n:]
        assert (entry.user, entry.action != "refused") == (user, True), path


def test_what_others_may_do_with_a_session_makes_something_of_their_own(bench):
    before = bench.state()
    for path in ("calibrate", "diagnose", "batch", "design"):
        answer = bench.ask("POST", f"/v1/jobs/{path}", "bert")
        assert answer.json()["user"] == "bert", answer.text
    after = bench.state()
    assert {name for name in before | after if before.get(name) != after.get(name)} == {"jobs"}


def test_all_tokens_of_a_user_go_on_with_a_session_and_a_renamed_rig_is_another_one(bench):
    renewed = bearer(bench.client, "anne")
    headers = {**renewed, "Content-Type": "application/x-ndjson"}
    path = f"/v1/sessions/{bench.open_id}"
    n = len(bench.audit())
    for line in bench.lines[:3]:
        assert bench.client.post(f"{path}/readings", content=line, headers=headers).status_code == 200
    assert [entry.action for entry in bench.audit()[n:]] == ["session.append"]  # once a token
    assert bench.client.post(f"{path}/close", headers=renewed).status_code == 200


def test_another_version_of_a_rig_does_not_make_its_registry_ones_own(bench, rig_text):
    bench.client.headers.update(bench.users["bert"])
    theirs = upload_rig(bench.client, rig_text + "\n# as Bert has it\n")
    mine = upload_rig(bench.client, re.sub(r"(?m)^name: .*$", "name: bert's rig", rig_text))
    session = {"session_id": bench.closed_id}
    for call in (
        ("/v1/jobs/recalibrate", {**session, "rig_id": theirs}),
        ("/v1/schedules", {"rig_id": theirs, "every_s": 60}),
        (f"/v1/rigs/{theirs}/registry/roll-back", {"version": 1}),
    ):
        told = refusal(bench.client.post(call[0], json=call[1]), 403)
        assert told["rule"].endswith("it belongs to anne")
    assert bench.client.post("/v1/schedules", json={"rig_id": mine, "every_s": 60}).status_code == 201


def test_no_user_takes_the_open_sessions_or_the_schedules_of_all(idle, rig_text, monkeypatch):
    monkeypatch.setattr(schedules, "MOST_OF_USER", 2)
    client = idle(require_tokens=True, most_open_sessions=5, most_open_sessions_per_user=2)
    made = {}
    for user in ("anne", "bert"):
        client.headers.update(bearer(client, user))
        rig_id = upload_rig(client, re.sub(r"(?m)^name: .*$", f"name: {user}", rig_text))
        for path, body in (("sessions", {"source": "x"}), ("schedules", {"every_s": 60})):
            made[user, path] = [
                client.post(f"/v1/{path}", json={"rig_id": rig_id, **body}).status_code for _ in range(3)
            ]
    for user in ("anne", "bert"):
        assert made[user, "sessions"] == [201, 201, 429]
        assert made[user, "schedules"] == [201, 201, 409]


def test_what_another_user_judges_elsewhere_keeps_no_session_from_being_judged(bench, rig_text):
    """A recalibration of Anne's sessions in Bert's registry hid them from Anne's schedule, and stood for hers in her registry."""
    bench.client.headers.update(bench.users["bert"])
    theirs = upload_rig(bench.client, re.sub(r"(?m)^name: .*$", "name: bert's rig", rig_text))
    for session_id in (bench.closed_id, bench.spare_id):
        body = {"session_id": session_id, "rig_id": theirs}
        assert bench.client.post("/v1/jobs/recalibrate", json=body).status_code == 201
    assert bench.ask("POST", "/v1/schedules/{schedule_id}/run", "anne").status_code == 202
    assert bench.core.schedules.tick() == 1
    with bench.core.database.writing() as db:
        found = {}
        for job in db.scalars(
            select(Job).where(Job.session_id == bench.closed_id, Job.kind == "recalibrate")
        ):
            found[job.user] = f"{job.user} calibration"
            row = CalibrationRow(id=found[job.user], job_id=job.id, session_id=job.session_id, user=job.user)
            row.rig_name, row.created = "small", f"2026-{len(found)}"
            db.add(row)
    assert set(found) == {"anne", "bert"}
    entry = SimpleNamespace(session=f"{bench.closed_id}.zarr")
    for rig_name, user in (("small", "anne"), ("bert's rig", "bert"), ("a third", None)):
        assert registries._calibration_id(bench.core, rig_name, entry) == found.get(user)


def test_a_roll_back_that_cannot_be_noted_is_not_made(bench, monkeypatch):
    made: list[object] = []

    def fails(*_: object) -> None:
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(registries, "roll_back", lambda *call: made.append(call))
    monkeypatch.setattr(Registry, "versions", [1])
    monkeypatch.setattr("estimator.service.requests.audited", fails)
    refusal(bench.ask("POST", "/v1/rigs/{rig_id}/registry/roll-back", "anne"), 507)
    assert made == []


def test_whatever_somebody_makes_is_noted_once(bench, rig_text, readings_csv):
    archive = bench.client.get(
        f"/v1/sessions/{bench.closed_id}/session.zip", headers=bench.users["anne"]
    ).content
    of_rig = {"params": {"rig_id": bench.rig_id}}
    token, _ = create_token(bench.core.database, "carl", Scope.WRITE, 1.0)
    calls: dict[str, dict[str, Any]] = {
        "/v1/login": {"json": {"token": token}},
        "/v1/rigs": {"content": rig_text + "\n", "headers": {"Content-Type": "application/yaml"}},
        "/v1/sessions": {"json": {"rig_id": bench.rig_id, "source": "x"}},
        "/v1/sessions/import-csv": {"content": readings_csv, "headers": {"Content-Type": CSV}, **of_rig},
        "/v1/sessions/import-zip": {"content": archive, "headers": {"Content-Type": ZIP}, **of_rig},
    }
    for (method, path), rule in sorted(RULES.items(), key=lambda item: item[0][0] == "DELETE"):
        if rule not in (NEW, ADMIN, SELF):
            continue
        n = len(bench.audit())
        if path == "/v1/logout":
            answer = bench.client.post(path, headers={"Origin": "http://127.0.0.1:8765"})
        elif path in calls:
            headers = {**calls[path].get("headers", {}), **bench.users["anne"]}
            answer = bench.client.request(method, path, **{**calls[path], "headers": headers})
        else:
            answer = bench.ask(method, path, "root" if rule == ADMIN else "anne")
        assert answer.is_success, (path, answer.text)
        assert len(bench.audit()) == n + 1, path


def test_refusals_do_not_fill_the_audit_log(bench, monkeypatch):
    begin_s = 60.0 * (time.time() // 60) + 20.0
    monkeypatch.setattr("limits.storage.memory.time.time", lambda: begin_s)
    n = len(bench.audit())
    for _ in range(rate_limits.MOST_NOTED + 20):
        refusal(bench.ask("DELETE", "/v1/sessions/{session_id}", "bert"), 403)
    assert len(bench.audit()) == n + rate_limits.MOST_NOTED


def test_a_refusal_is_told_though_it_cannot_be_noted(bench, monkeypatch):
    def fails(*_: object, **__: object) -> None:
        raise OSError("no audit")

    monkeypatch.setattr(guard, "Audit", fails)
    refusal(bench.ask("DELETE", "/v1/sessions/{session_id}", "bert"), 403)


def test_an_application_with_a_change_that_asks_for_no_owner_is_not_made(tmp_path):
    router = APIRouter()

    @router.put("/v1/sessions/{session_id}")
    def rename(caller: Writer, session_id: Id) -> str:  # noqa: ARG001
        return session_id

    routers = operation.router
    before = list(routers.routes)
    routers.include_router(router)
    try:
        with pytest.raises(RuntimeError, match="must ask whose it is"):
            create_app(Settings(data=tmp_path / "data"), has_workers=False)
    finally:
        routers.routes[:] = before


def test_a_cookie_is_worth_nothing_after_the_logout_wherever_it_was_copied_to(bench):
    core: Core = bench.core
    token, token_id = create_token(core.database, "anne", Scope.WRITE, 1.0)
    page = {"Origin": "http://127.0.0.1:8765", "Sec-Fetch-Site": "same-origin"}
    browsers = [TestClient(bench.client.app, base_url="http://127.0.0.1:8765") for _ in range(2)]
    for browser in browsers:
        assert browser.post("/v1/login", json={"token": token}, headers=page).status_code == 200
    copies = [{"Cookie": "; ".join(f"{k}={v}" for k, v in browser.cookies.items())} for browser in browsers]
    assert copies[0] != copies[1]
    n = len(bench.audit())
    assert browsers[0].post("/v1/logout", headers=page).status_code == 204
    assert [(e.action, e.user, e.target) for e in bench.audit()[n:]] == [("logout", "anne", token_id)]
    refusal(bench.client.get("/v1/state", headers=copies[0]), 401)
    refusal(bench.client.post("/v1/logout", headers={**copies[0], **page}), 401)
    assert bench.client.get("/v1/state", headers=copies[1]).json()["user"] == "anne"  # logged in by itself
    revoke_token(core.database, token_id)
    refusal(bench.client.get("/v1/state", headers=copies[1]), 401)


def test_a_stream_ends_when_its_token_is_revoked(bench, monkeypatch):
    monkeypatch.setattr(guard, "RECHECK_S", 0.05)
    token, token_id = create_token(bench.core.database, "anne", Scope.READ, 1.0)
    headers = {"Authorization": f"Bearer {token}"}
    begin_s = time.monotonic()

    def revoke() -> None:
        time.sleep(0.5)
        revoke_token(bench.core.database, token_id)

    thread = threading.Thread(target=revoke)
    thread.start()
    answer = bench.client.get(
        f"/v1/jobs/{bench.job_id}/events", headers=headers
    )  # of a job that waits for ever
    thread.join()
    assert answer.status_code == 200
    assert "event: end" not in answer.text
    assert 0.4 < time.monotonic() - begin_s < 10.0
