"""Jobs and sessions are deleted when that is asked for, in an order that leaves nothing behind, and old jobs by themselves."""

from __future__ import annotations

from pathlib import Path

from starlette.testclient import TestClient

from estimator.service.cache import Cache
from estimator.service.core import Core
from estimator.service.job_queue import DONE
from estimator.service.removal import remove_folders_without_row
from estimator.service.schema import CalibrationRow, Job
from tests.estimator.service.conftest import (
    append,
    bearer,
    begin_session,
    import_csv,
    lines_of,
    refusal,
    upload_rig,
)

LONG_AGO = "2020-01-01T00:00:00.000+00:00"


def asked(client: TestClient, kind: str, session_id: str) -> str:
    answer = client.post(f"/v1/jobs/{kind}", json={"session_id": session_id})
    assert answer.status_code in (200, 201, 202), answer.text
    return str(answer.json()["id"])


def ended(core: Core, job_id: str, when: str) -> Path:
    """Let a job have ended, with a folder and a calibration."""
    folder = core.jobs.folder(job_id)
    folder.mkdir(parents=True)
    (folder / "result.json").write_text("{}")
    with core.database.writing() as db:
        job = db.query(Job).filter(Job.id == job_id).one()
        job.state, job.ended = DONE, when
        row = CalibrationRow(id=f"{job_id[::-1]}", job_id=job_id, session_id=job.session_id, rig_name="r")
        row.created, row.user = when, job.user
        db.add(row)
    return folder


def test_a_job_goes_with_its_calibration_and_its_folder_then_its_session(filled):
    client, session_id = filled()
    core: Core = client.app.state.core
    job_id = asked(client, "calibrate", session_id)
    assert "must have ended" in refusal(client.delete(f"/v1/jobs/{job_id}"), 409)["rule"]
    told = refusal(client.delete(f"/v1/sessions/{session_id}"), 409)
    assert told["value"] == f"calibrate {job_id} of local (queued)"
    folder = ended(core, job_id, LONG_AGO)
    assert client.get("/v1/calibrations").json()["items"]
    loaded: list[Path] = []
    core._calibrations = Cache(lambda path: loaded.append(path) or path, 10)
    other = core.jobs.folder("0" * 32) / "calibration"
    for path in (folder / "calibration", folder / "diagnosis" / "calibration", other):
        core.calibration(path)
    assert client.delete(f"/v1/jobs/{job_id}").status_code == 204
    assert not folder.exists()
    assert list(core._calibrations._values) == [other]  # what is deleted leaves memory too
    assert client.get("/v1/calibrations").json()["items"] == []
    refusal(client.get(f"/v1/jobs/{job_id}"), 404)
    assert client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert not core.sessions.path(session_id).exists()
    refusal(client.delete(f"/v1/sessions/{session_id}"), 404)


def test_a_session_of_a_batch_stays_and_a_judgement_goes_with_its_session(idle, rig_text, readings_csv):
    client = idle()
    core: Core = client.app.state.core
    rig_id = upload_rig(client, rig_text)
    first, second = (import_csv(client, rig_id, readings_csv)["id"] for _ in range(2))
    batch = client.post("/v1/jobs/batch", json={"session_ids": [first, second]}).json()["id"]
    judgement = asked(client, "recalibrate", second)
    folder = ended(core, judgement, LONG_AGO)
    assert "goes with the session" in refusal(client.delete(f"/v1/jobs/{judgement}"), 409)["rule"]
    assert f"batch {batch} of local" in refusal(client.delete(f"/v1/sessions/{second}"), 409)["detail"]
    ended(core, batch, LONG_AGO)
    assert client.delete(f"/v1/jobs/{batch}").status_code == 204
    assert client.delete(f"/v1/sessions/{second}").status_code == 204
    assert not folder.exists()


def test_an_open_session_goes_without_a_trace_and_makes_room_for_another(
    idle, rig_text, small_session, small_rig
):
    client = idle(most_open_sessions=1)
    rig_id = upload_rig(client, rig_text)
    session_id = begin_session(client, rig_id)
    assert append(client, session_id, lines_of(small_session, small_rig)).status_code == 200
    refusal(client.post("/v1/sessions", json={"rig_id": rig_id, "source": "another"}), 429)
    assert client.delete(f"/v1/sessions/{session_id}").status_code == 204
    assert client.app.state.core.sessions._writers == {}
    refusal(append(client, session_id, lines_of(small_session, small_rig)), 404)
    begin_session(client, rig_id)


def test_what_holds_a_session_is_told_with_its_user_and_what_ends_it(idle, rig_text, readings_csv):
    client = idle(require_tokens=True)
    anne, bert = (bearer(client, user) for user in ("anne", "bert"))
    client.headers.update(anne)
    path = f"/v1/sessions/{import_csv(client, upload_rig(client, rig_text), readings_csv)['id']}"
    session_id = path.rpartition("/")[2]
    own = asked(client, "calibrate", session_id)
    client.headers.update(bert)
    others = asked(client, "diagnose", session_id)
    client.headers.update(anne)
    told = refusal(client.delete(path), 409)
    assert told["value"] == f"calibrate {own} of anne (queued), diagnose {others} of bert (queued)"
    assert told["rule"] == (
        "must have no jobs; cancel yours unless ended (POST /v1/jobs/ID/cancel), then delete yours (DELETE /v1/jobs/ID), "
        "then ask bert or an admin to delete the others"
    )
    assert client.post(f"/v1/jobs/{own}/cancel").status_code == 200
    assert client.delete(f"/v1/jobs/{own}").status_code == 204
    assert refusal(client.delete(path), 409)["rule"] == (
        "must have no jobs; ask bert or an admin to delete the others"
    )
    admin = bearer(client, "root", "admin")
    assert "cancel them unless ended" in refusal(client.delete(path, headers=admin), 409)["rule"]
    assert client.post(f"/v1/jobs/{others}/cancel", headers=admin).status_code == 200
    assert client.delete(f"/v1/jobs/{others}", headers=admin).status_code == 204
    assert client.delete(path).status_code == 204


def test_old_jobs_are_removed_by_themselves_where_the_settings_say_so(filled):
    client, session_id = filled(keep_jobs_days=30)
    core: Core = client.app.state.core
    old, fresh = (asked(client, "calibrate", session_id) for _ in range(2))
    judgement = asked(client, "recalibrate", session_id)
    gone, *kept = (
        ended(core, old, LONG_AGO),
        ended(core, fresh, "2999-01-01T00:00:00.000+00:00"),
        ended(core, judgement, LONG_AGO),
    )
    assert (core.remove_old_jobs(), core.remove_old_jobs()) == (1, 0)
    assert not gone.exists()
    assert all(folder.exists() for folder in kept)
    (core.jobs.folder("f" * 32)).mkdir()  # as a kill between row and folder leaves it
    remove_folders_without_row(core.database, core.data / "jobs")
    assert sorted(path.name for path in (core.data / "jobs").iterdir()) == sorted([fresh, judgement])
