"""Readings: appended once, whatever is sent again; imported, downloaded, and refused where they are damaged."""

from __future__ import annotations

import json
import stat
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import pytest
from starlette.testclient import TestClient

from estimator.store.session import load_session
from estimator.store.zipped import zipped
from tests.estimator.service.conftest import (
    CSV,
    YAML,
    append,
    begin_session,
    import_csv,
    lines_of,
    numbered,
    refusal,
    send_zip,
    sent,
    upload_rig,
    zip_of,
)

LIMITS = {"most_readings": 36, "most_open_sessions": 3, "most_body_MB": 1.0, "most_unpacked_MB": 0.2}


@pytest.fixture
def client(idle: Callable[..., TestClient]) -> TestClient:
    return idle(**LIMITS)


@pytest.fixture(scope="module")
def refusing(idle_for_all: Callable[..., TestClient], rig_text: str) -> tuple[TestClient, str, str]:
    """A service that no test of this module changes, a rig in it and an open session of it."""
    client = idle_for_all(**LIMITS)
    rig_id = upload_rig(client, rig_text)
    return client, rig_id, begin_session(client, rig_id)


@pytest.fixture
def rig_id(client: TestClient, rig_text: str) -> str:
    return upload_rig(client, rig_text)


@pytest.fixture
def session_id(client: TestClient, rig_id: str) -> str:
    return begin_session(client, rig_id)


def test_a_rig_is_one_version_by_its_text(client, rig_text):
    first, again, other = (
        sent(client, "/v1/rigs", text, YAML) for text in (rig_text, rig_text, rig_text + "\n")
    )
    assert [answer.status_code for answer in (first, again, other)] == [201, 200, 201]
    assert first.json() == again.json()
    assert first.json()["name"] == other.json()["name"]
    assert first.json()["id"] != other.json()["id"]
    path = f"/v1/rigs/{first.json()['id']}/text"
    text = client.get(path)
    assert text.text == rig_text
    assert client.get(path, headers={"If-None-Match": text.headers["etag"]}).status_code == 304
    names = sent(client, "/v1/rigs/validate", rig_text, YAML).json()
    assert (names["coils"], names["sensors"], names["movers"]) == (["coil1"], ["hall"], ["arm1"])
    assert len(client.get("/v1/rigs", params={"name": "small"}).json()["items"]) == 2


def test_a_faulty_rig_is_refused_with_thing_rule_value_and_line(client, rig_text):
    faulty = rig_text.replace("wire_radius_mm: 0.98", "wire_radius_mm: -0.98")
    problem = refusal(sent(client, "/v1/rigs", faulty, YAML), 422)
    assert problem["thing"] == "coils.coil1.wire_radius_mm"
    assert problem["rule"].startswith("must be")
    assert problem["place"] == "body, line 10"
    assert problem["value"] == "-0.98"


def test_appended_readings_are_those_of_the_session(client, session_id, small_session, small_rig):
    body = lines_of(small_session, small_rig, 0, 30)
    lines = body.splitlines(keepends=True)
    assert append(client, session_id, b"".join(lines[:10])).json() == {"n_readings": 10, "n_new": 10}
    assert append(client, session_id, b"".join(lines[:10])).json() == {"n_readings": 10, "n_new": 0}
    assert append(client, session_id, b"".join(lines[5:20])).json() == {"n_readings": 20, "n_new": 10}
    assert client.get(f"/v1/sessions/{session_id}").json()["n_readings"] == 20
    assert append(client, session_id, b"".join(lines[20:])).json() == {"n_readings": 30, "n_new": 10}
    closed = client.post(f"/v1/sessions/{session_id}/close").json()
    assert (closed["state"], closed["n_readings"]) == ("closed", 30)
    assert client.post(f"/v1/sessions/{session_id}/close").json() == closed
    stored = load_session(client.app.state.core.sessions.path(session_id))
    assert stored.hash == closed["hash"]
    assert stored.observations.field_sensor_T.equal(small_session.observations.field_sensor_T[:30])
    assert stored.observations.motion["arm1"].equal(small_session.observations.motion["arm1"][:30])
    assert "must be open" in refusal(append(client, session_id, lines[0]), 409)["detail"]


def test_readings_are_on_disk_before_the_answer_with_one_wait_for_all(
    client, session_id, small_session, small_rig, monkeypatch
):
    journal = client.app.state.core.sessions.path(session_id) / "journal.jsonl"
    sizes: list[int] = []
    monkeypatch.setattr("estimator.store.journal.os.fsync", lambda _: sizes.append(journal.stat().st_size))
    assert append(client, session_id, lines_of(small_session, small_rig, 0, 10)).status_code == 200
    assert sizes == [journal.stat().st_size]


def test_a_gap_another_reading_and_too_many_are_refused(client, session_id, small_session, small_rig):
    lines = numbered(small_session, small_rig, 37)
    assert append(client, session_id, lines[0]).status_code == 200
    gap = refusal(append(client, session_id, lines[2]), 409)
    assert gap["rule"] == "must continue at 1, where the session ends"
    other = json.dumps({**json.loads(lines[0]), "repeat": 3}).encode()
    assert refusal(append(client, session_id, other), 409)["thing"] == "reading 0"
    too_many = refusal(append(client, session_id, b"".join(lines[1:])), 409)
    assert too_many["rule"] == "must have at most 36 readings"
    assert refusal(append(client, session_id, lines[1] + lines[3]), 422)["place"] == "body, line 2"
    early = json.dumps({**json.loads(lines[1]), "time_s": 0.0}).encode()
    assert "later" in refusal(append(client, session_id, early), 422)["rule"]
    assert client.get(f"/v1/sessions/{session_id}").json()["n_readings"] == 1


@pytest.mark.parametrize(
    ("change", "thing"),
    [
        ({"current_A": {}}, "current_A"),
        ({"current_A": {"coil1": 1e300}}, "current_A.coil1"),
        ({"current_A": {"coil1": "3"}}, "current_A.coil1"),
        ({"field_T": {}}, "field_T"),
        ({"field_T": {"probe": [0, 0, 0]}}, "field_T"),
        ({"field_T": {"hall": [0, 0]}}, "field_T.hall"),
        ({"motion": {}}, "motion"),
        ({"motion": {"arm1": [0, 0, 0, 0, 0, 0], "arm2": [0, 0, 0, 0, 0, 0]}}, "motion"),
        ({"sequence": -1}, "sequence"),
        ({"sequence": 10**30}, "sequence"),
        ({"humidity": 1}, "humidity"),
    ],
)
def test_a_reading_that_is_none_of_the_rig_is_refused_with_its_line(
    refusing, small_session, small_rig, change, thing
):
    client, _, session_id = refusing
    good, next_good = lines_of(small_session, small_rig, 0, 2).splitlines(keepends=True)
    bad = json.dumps({**json.loads(next_good), **change}).encode()
    problem = refusal(append(client, session_id, good + bad), 422)
    assert (problem["thing"], problem["place"]) == (thing, "body, line 2")
    assert client.get(f"/v1/sessions/{session_id}").json()["n_readings"] == 0


def test_open_sessions_are_limited_and_an_empty_one_is_not_closed(client, rig_id):
    first, *_ = [begin_session(client, rig_id) for _ in range(3)]
    answer = client.post("/v1/sessions", json={"rig_id": rig_id, "source": "a test"})
    assert refusal(answer, 429)["thing"] == "open sessions"
    assert "must hold a reading" in refusal(client.post(f"/v1/sessions/{first}/close"), 409)["detail"]
    calibrate = client.post("/v1/jobs/calibrate", json={"session_id": first})
    assert "closed first" in refusal(calibrate, 409)["rule"]


def test_csv_and_zip_come_back_as_they_went(client, rig_id, readings_csv, small_session, tmp_path):
    session = import_csv(client, rig_id, readings_csv)
    assert client.get(f"/v1/sessions/{session['id']}/readings.csv").content == readings_csv
    archive = client.get(f"/v1/sessions/{session['id']}/session.zip")
    again = send_zip(client, rig_id, archive.content)
    assert again.json()["hash"] == session["hash"]
    tag = {"If-None-Match": archive.headers["etag"]}
    assert client.get(f"/v1/sessions/{session['id']}/session.zip", headers=tag).status_code == 304
    small_session.save(tmp_path / "small.zarr")
    own = send_zip(client, rig_id, zipped(tmp_path / "small.zarr")).json()
    assert own["hash"] == small_session.hash
    stored = load_session(client.app.state.core.sessions.path(own["id"]))
    assert stored.truth == small_session.truth
    assert not list(client.app.state.core.uploads.iterdir())


def send_csv(client: TestClient, csv: bytes, **params: str) -> Any:
    return sent(client, "/v1/sessions/import-csv", csv, CSV, params=params)


def test_a_faulty_csv_is_refused_with_its_line(client, rig_id, readings_csv):
    faulty = readings_csv.replace(b"3.0", b"three", 1)
    problem = refusal(send_csv(client, faulty, rig_id=rig_id), 422)
    assert problem["place"].startswith("readings.csv, line 2")
    assert "/" not in problem["detail"]


def test_sessions_are_labelled_and_found_by_their_labels(client, rig_id, readings_csv):
    first, second = (import_csv(client, rig_id, readings_csv) for _ in range(2))
    assert (first["name"], first["note"], first["tags"]) == (None, None, [])
    path = f"/v1/sessions/{first['id']}"
    labels = {"name": "Coil 7, cold", "note": "100 % nitrogen", "tags": ["cold", "cold", "new-probe"]}
    told = client.patch(path, json={**labels, "measured": "2026-03-02"}).json()
    assert (told["name"], told["note"], told["tags"]) == (
        "Coil 7, cold",
        "100 % nitrogen",
        ["cold", "new-probe"],
    )
    assert told["measured"] == "2026-03-02"
    assert client.patch(path, json={"note": None}).json()["tags"] == ["cold", "new-probe"], "the others stay"

    def found(text: str) -> list[str]:
        page = client.get("/v1/sessions", params={"search": text}).json()
        return [session["id"] for session in page["items"]]

    assert found("COLD coil") == found("new-probe") == [first["id"]]
    assert set(found("")) == {first["id"], second["id"]}
    assert found("100 %") == found("col_") == [], "the note is gone, and _ is no wildcard"
    for body in ({"tags": ["two words"]}, {"measured": "Monday"}, {"colour": "red"}, {"name": "x" * 201}):
        refusal(client.patch(path, json=body), 422)
    job = client.post("/v1/jobs/calibrate", json={"session_id": first["id"], "seed": 1}).json()
    named = client.patch(f"/v1/jobs/{job['id']}", json={"name": "with the new probe"}).json()
    assert (named["name"], named["tags"]) == ("with the new probe", [])
    assert [one["id"] for one in client.get("/v1/jobs", params={"search": "new probe"}).json()["items"]] == [
        job["id"]
    ]
    assert client.get("/v1/jobs", params={"search": "old"}).json()["items"] == []


def test_a_preview_says_what_each_column_is_taken_for_and_stores_nothing(client, rig_id, readings_csv):
    def preview(content: bytes, **more: str) -> dict[str, Any]:
        call = {"content": content, "headers": {"Content-Type": "text/csv"}}
        answer = client.post("/v1/sessions/preview-csv", params={"rig_id": rig_id, **more}, **call)
        assert answer.status_code == 200, answer.text
        return dict(answer.json())

    plain = preview(readings_csv)
    assert (plain["remarks"], plain["fault"]) == ([], "")
    header, first = readings_csv.decode().splitlines()[:2]
    assert [column["header"] for column in plain["columns"]] == header.split(",")
    other = readings_csv.replace(b"Bx_T", b"Hall Bx [T]", 1).replace(b"t_s", b"time [s]", 1)
    told = preview(other)
    names = {column["header"]: column["name"] for column in told["columns"]}
    assert (names["Hall Bx [T]"], told["lines"]) == ("Bx_T", [2, 3, 4])
    assert told["n_readings"] == len(readings_csv.splitlines()) - 1
    values = {column["header"]: column["values"][0] for column in told["columns"]}
    assert values["Hall Bx [T]"] == f"{float(first.split(',')[header.split(',').index('Bx_T')]):.6g} T"
    assert {"Bx_mT", "t_ms", "clock", "-"} <= set(told["names"])
    torn = preview(readings_csv.replace(b"Bx_T", b"Probe 7", 1), column="Probe 7=Bx_mm")
    assert torn["n_readings"] is None
    assert "must have a unit of field" in torn["fault"]
    assert torn["fault"].endswith("(readings.csv, line 1)"), "no folder of the service"
    assert {column["header"]: column["name"] for column in torn["columns"]}["Probe 7"] == "Bx_mm"
    assert client.get("/v1/sessions").json()["items"] == []


def test_another_table_is_taken_where_what_was_understood_is_accepted(client, rig_id, readings_csv):
    other = readings_csv.replace(b"Bx_T", b"Hall Bx [T]", 1)
    problem = refusal(send_csv(client, other, rig_id=rig_id), 422)
    assert "must be accepted with accept=true" in problem["detail"]
    assert "'Hall Bx [T]' is Bx_T" in problem["detail"]
    accepted = send_csv(client, other, rig_id=rig_id, accept="true")
    assert accepted.json()["hash"] == import_csv(client, rig_id, readings_csv)["hash"]
    packed = send_csv(client, b"\x89HDF\r\n\x1a\n" + other, rig_id=rig_id)
    assert "must be text" in refusal(packed, 415)["detail"]
    named = send_csv(client, other, rig_id=rig_id, column="Hall Bx [T]=Bx_furlong")
    assert "must be one that the rig knows" in refusal(named, 422)["detail"]


def small_promise() -> bytes:
    """A member whose header promises four bytes and which unfolds to ten million."""
    honest = bytearray(zip_of({"zarr.json": b"0" * 10_000_000}))
    for position in (honest.find(b"PK\x03\x04") + 22, honest.find(b"PK\x01\x02") + 24):
        honest[position : position + 4] = struct.pack("<I", 4)
    return bytes(honest)


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        (b"PK no zip at all", 422, "zip file"),
        (b"", 422, "zip file"),
        (small_promise(), 422, "zip file"),
        (zip_of({"C:x": b"x"}), 422, "relative names"),
        (zip_of({"a/../../outside": b"x"}), 422, "relative names"),
        (zip_of({"x" * 5000: b"x"}), 422, "200 characters"),
        (zip_of({"a\r\nSet-Cookie: x=1": b"x"}), 422, "relative names"),
        (zip_of({"zarr.json": zip_of({"zarr.json": b"{}"})}), 422, "must be readable as text"),
        (zip_of({"../outside": b"x"}), 422, "relative names"),
        (zip_of({"/etc/outside": b"x"}), 422, "relative names"),
        (zip_of({"a\\..\\outside": b"x"}), 422, "relative names"),
        (zip_of({"link": b"/etc/passwd"}, stat.S_IFLNK | 0o777), 422, "files and folders only"),
        (zip_of({"bomb": b"\0" * 300_000}), 413, "when unpacked"),
        (zip_of({"zarr.json": b"{}"}, method=zipfile.ZIP_BZIP2), 422, "stored or deflated"),
        (zip_of({"a/b/c/d/e/f/g/h": b""}), 422, "levels"),
        (zip_of({"notes.txt": b"hello"}), 422, "zarr.json"),
        (zip_of({"zarr.json": b'{"zarr_format": 2}'}), 422, "format 3"),
        (zip_of({"zarr.json": b"{}", ".zgroup": b"{}"}), 422, "format"),
        (zip_of({"zarr.json": b"not json"}), 422, "zarr.json must be JSON"),
    ],
)
def test_an_archive_that_is_no_session_is_refused_and_leaves_nothing(refusing, body, status, words):
    client, rig_id, session_id = refusing
    problem = refusal(send_zip(client, rig_id, body), status)
    assert words in problem["detail"]
    data = client.app.state.core.data
    assert str(data) not in problem["detail"]
    assert not list(client.app.state.core.uploads.iterdir())
    assert [path.stem for path in data.glob("sessions/*")] == [session_id]
    assert not (data.parent / "outside").exists()


def test_a_session_with_an_altered_byte_is_refused(client, rig_id, small_session, tmp_path):
    small_session.save(tmp_path / "small.zarr")
    chunk = next((tmp_path / "small.zarr" / "field_sensor_T").rglob("c/*/*"))
    content = bytearray(chunk.read_bytes())
    content[len(content) // 2] ^= 1
    chunk.write_bytes(content)
    assert "damaged" in refusal(send_zip(client, rig_id, zipped(tmp_path / "small.zarr")), 422)["detail"]


def test_a_session_of_another_rig_is_refused(client, two_coils_text, small_session, tmp_path):
    small_session.save(tmp_path / "small.zarr")
    refused = send_zip(client, upload_rig(client, two_coils_text), zipped(tmp_path / "small.zarr"))
    assert "must be those of the session" in refusal(refused, 422)["detail"]


def test_a_closed_session_is_asked_what_causes_would_do(api, rig_text, readings_csv):
    session_id = import_csv(api, upload_rig(api, rig_text), readings_csv)["id"]
    causes = api.get(f"/v1/sessions/{session_id}/causes").json()
    assert ("axis_gain[hall]", "sensor") in {(cause["label"], cause["kind"]) for cause in causes}
    told = api.get(f"/v1/sessions/{session_id}/what-if", params={"cause": "axis_gain[hall]"}).json()
    assert [pattern["key"] for pattern in told["patterns"]] == ["x", "y", "z"]
    assert len(told["patterns"][0]["left_T"]) == len(told["position_m"])
    refused = api.get(f"/v1/sessions/{session_id}/what-if", params={"cause": "axis_gain[probe]"})
    refusal(refused, 422)
    rig_id = upload_rig(api, rig_text)
    assert refusal(api.get(f"/v1/sessions/{begin_session(api, rig_id)}/causes"), 409)["thing"] == "session"
