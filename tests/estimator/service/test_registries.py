"""Recalibrations over HTTP: a session is judged, the registry tells of it, and an earlier version comes back; batch and design beside them."""

from __future__ import annotations

import json
from typing import Any

import pytest
import torch
from starlette.testclient import TestClient

from estimator.recalibration.registry import Registry
from estimator.service import tasks
from estimator.service.core import Core
from estimator.service.tasks import AssignedJob
from estimator.store.importers.readings_csv import write_readings_csv
from estimator.store.session import Session
from tests.estimator.service.conftest import QUICK, import_csv, refusal, upload_rig, wait_for


@pytest.fixture(scope="module")
def rig_id(api: TestClient, rig_text: str) -> str:
    """A rig of its own name, so of its own registry."""
    return upload_rig(api, rig_text.replace("name: small", "name: yearly"))


@pytest.fixture(scope="module")
def session_id(api: TestClient, rig_id: str, readings_csv: bytes) -> str:
    return str(import_csv(api, rig_id, readings_csv)["id"])


@pytest.fixture(scope="module")
def first(api: TestClient, session_id: str) -> dict[str, Any]:
    """The first calibration of the registry, its result and job."""
    body = {"session_id": session_id, "seed": 1, "settings": QUICK}
    job = wait_for(api, api.post("/v1/jobs/recalibrate", json=body).json()["id"])
    assert (job["state"], job["fault"]) == ("done", None)
    return {"job": job, **api.get(f"/v1/jobs/{job['id']}/result").json()}


def test_the_first_session_makes_the_first_version(api, rig_id, session_id, first):
    path = f"/v1/rigs/{rig_id}/registry"
    assert first["result"]["conclusion"] == "updated"
    assert first["result"]["session"] == session_id
    state = {"rig_name": "yearly", "current": 1, "calibration_id": first["calibration_id"]}
    assert api.get(path).json() == {**state, "n_versions": 1, "n_entries": 1}
    (version,) = api.get(f"{path}/versions").json()["items"]
    assert (version["version"], version["is_current"], version["session_id"]) == (1, True, session_id)
    summary = api.get(f"/v1/calibrations/{first['calibration_id']}/summary").json()
    expected = summary["parameters"]["coil1.radius_m"]
    assert version["parameters"]["coil1.radius_m"]["ci90"] == expected["ci90"]
    page = api.get(f"/v1/jobs/{first['job']['id']}/report").text
    assert "Version 1 is in use" in page
    assert str(api.app.state.core.data) not in page


def test_a_session_that_was_judged_is_not_judged_again(api, rig_id, session_id, first):
    body = {"session_id": session_id, "seed": 2, "settings": QUICK}
    job = wait_for(api, api.post("/v1/jobs/recalibrate", json=body).json()["id"])
    again = api.get(f"/v1/jobs/{job['id']}/result").json()
    assert again["result"] == first["result"]
    assert api.get(f"/v1/rigs/{rig_id}/registry").json()["n_entries"] == 1


def test_an_earlier_version_comes_back_and_the_log_has_pages(api, rig_id, first):
    path = f"/v1/rigs/{rig_id}/registry"
    core: Core = api.app.state.core
    registry = Registry(core.registry_path("yearly"))
    with registry.writing():  # a second version, as another session makes it
        registry.commit(registry.entries()[0], registry.calibration(1))
    assert api.get(path).json()["current"] == 2
    refused = refusal(api.post(f"{path}/roll-back", json={"version": 7}), 422)
    assert str(core.data) not in refused["detail"]
    with registry.writing():
        assert refusal(api.post(f"{path}/roll-back", json={"version": 1}), 409)["thing"] == "registry"
    entry = api.post(f"{path}/roll-back", json={"version": 1}).json()
    assert (entry["conclusion"], entry["version"], entry["number"]) == ("rolled_back", 1, 3)
    assert api.get(path).json()["current"] == 1
    assert api.get(path).json()["calibration_id"] == first["calibration_id"]
    whole = api.get(f"{path}/entries").json()["items"]
    assert [item["number"] for item in whole] == [3, 2, 1]
    page = api.get(f"{path}/entries", params={"limit": 2}).json()
    assert page["items"] == whole[:2]
    rest = api.get(f"{path}/entries", params={"limit": 2, "cursor": page["next"]}).json()
    assert (rest["items"], rest["next"]) == (whole[2:], None)
    refusal(api.get(f"{path}/entries", params={"cursor": "-1"}), 422)
    over_time = api.get(f"{path}/history").json()
    assert (over_time["rig_name"], over_time["current"]) == ("yearly", 1)
    assert [period["version"] for period in over_time["periods"]] == [1, 2, 1]
    assert [period["end"] for period in over_time["periods"]][:2] == [
        period["begin"] for period in over_time["periods"]
    ][1:]
    assert [session["conclusion"] for session in over_time["sessions"]] == ["updated", "updated"]
    known = api.get(f"/v1/calibrations/{first['calibration_id']}/summary").json()["parameters"]
    lower, median, upper = over_time["periods"][0]["intervals"]["coil1.radius_m"]
    assert ([lower, upper], median) == (known["coil1.radius_m"]["ci90"], known["coil1.radius_m"]["median"])
    assert over_time["units"]["coil1.radius_m"] == "m"
    assert not any(known[name]["is_derived"] for name in over_time["periods"][0]["intervals"])
    assert str(core.data) not in json.dumps(over_time)
    audit = api.get("/v1/audit").json()
    assert (audit[0]["action"], audit[0]["target"]) == ("registry.roll_back", f"{rig_id} 1")


def test_a_batch_fits_every_session_under_every_hypothesis(api, rig_id, session_id, small_session, tmp_path):
    path = tmp_path / "fewer.csv"
    fewer = Session(small_session.rig, small_session.observations.rows(torch.arange(30)), "fewer")
    write_readings_csv(fewer, path)
    other = str(import_csv(api, rig_id, path.read_bytes())["id"])
    body = {"session_ids": [session_id, other], "hypotheses": ["plain", "axis_gain"], "has_posterior": False}
    job = wait_for(api, api.post("/v1/jobs/batch", json=body).json()["id"])
    assert (job["state"], job["fault"]) == ("done", None)
    found = api.get(f"/v1/jobs/{job['id']}/result").json()
    assert found["calibration_id"] is None
    fits = found["result"]["fits"]
    assert found["result"]["failed"] == {}
    assert [(fit["session"], fit["hypothesis"]) for fit in fits] == [
        (s, h) for s in (session_id, other) for h in ("plain", "axis_gain")
    ]
    assert sum(fit["probability"] for fit in fits[:2]) == pytest.approx(1.0)
    assert "Batch of 2 sessions" in api.get(f"/v1/jobs/{job['id']}/report").text


def test_a_design_gives_a_plan(api, session_id):
    body = {"session_id": session_id, "shrink": "coil1.radius_m", "n_readings": 3}
    job = wait_for(api, api.post("/v1/jobs/design", json=body).json()["id"])
    found = api.get(f"/v1/jobs/{job['id']}/result").json()["result"]
    assert found["goal"] == "shrink coil1.radius_m"
    assert len(found["reached"]) == 3
    assert found["reached"][-1] < found["so_far"]
    assert "schema_version" in found["plan"]
    refusal(api.get(f"/v1/jobs/{job['id']}/report"), 404)
    body = {"session_id": session_id}
    job = wait_for(api, api.post("/v1/jobs/design", json=body).json()["id"])
    assert job["fault"].startswith("a design must split two or more causes")


def test_two_recalibrations_of_one_rig_take_turns(tmp_path, small_session, monkeypatch):
    """The second waits in its worker, and says so."""
    session = tmp_path / "a.zarr"
    small_session.save(session)
    told: list[str] = []
    registry = Registry(tmp_path / "registry")

    class Enough(Exception):
        pass

    def tell(words: str, _: Any) -> None:
        told.append(words)
        if len(told) == 3:
            raise Enough

    monkeypatch.setattr(tasks, "LOOK_EVERY_S", 0.01)
    job = {"options": {"seed": 0, "settings": QUICK}, "registry": str(registry.folder), "rig": None}
    job |= {"has_alerts": False}
    with registry.writing(), pytest.raises(Enough):
        tasks.recalibrate_job(AssignedJob(job, tmp_path, session, tell))
    assert told[1:] == ["waiting for another recalibration of this rig"] * 2
