"""Requests that no client sends: refused with a sentence, at once, and the service goes on."""

from __future__ import annotations

import json
import re
import time
from typing import Any

import pytest
import zarr

from estimator.store.zipped import zipped
from tests.estimator.service.conftest import (
    CSV,
    JSON,
    YAML,
    ZIP,
    append,
    begin_session,
    lines_of,
    refusal,
    send_zip,
    sent,
    upload_rig,
    zip_of,
)

LONGEST_S = 20.0  # on a busy computer
DEEP, NINES = b"[" * 200_000, b"9" * 100_000
ID = "0" * 32

JSON_BODIES: dict[str, bytes] = {
    "nothing": b"",
    "depth": DEEP,
    "deep sections": b'{"a":' * 100_000,
    "a depth that ends": DEEP + b"]" * 200_000,
    "many digits": b'{"seed": ' + NINES + b"}",
    "a large exponent": b'{"seed": 1e999999}',
    "no number": b'{"seed": NaN}',
    "half a character": b'{"rig_id": "' + ID.encode() + b'", "source": "\\ud800"}',
    "a null character": b'{"rig_id": "' + ID.encode() + b'", "source": "\\u0000"}',
    "other bytes": b"\xff\xfe{}",
    "a list": b"[]",
    "null": b"null",
    "a key twice": b'{"source": "a", "source": "b"}',
    "half a character as a key": b'{"\\ud800": 1}',
    "a long key": b'{"' + b"k" * 100_000 + b'": 1}',
    "a path as id": b'{"rig_id": "../../../etc/passwd", "source": "x"}',
    "a list as id": b'{"rig_id": ["' + ID.encode() + b'"], "source": "x"}',
    "a prototype": b'{"__proto__": {"x": 1}, "rig_id": "' + ID.encode() + b'", "source": "x"}',
    "a byte order mark": b"\xef\xbb\xbf{}",
}
ROUTES = ("/v1/sessions", "/v1/jobs/calibrate", "/v1/jobs/diagnose", f"/v1/calibrations/{ID}/predict")
QUERIES = (
    "/v1/rigs?name=%00",
    "/v1/rigs?name=%ff%fe",
    f"/v1/rigs?name={'x' * 5000}",
    "/v1/rigs?limit=" + "9" * 5000,
    "/v1/rigs?name=' OR 1=1 --&limit=0",
    "/v1/rigs?cursor=%00",
    "/v1/rigs?cursor=..%2f..%2f",
    "/v1/rigs?cursor=AAAA",
    "/v1/rigs?cursor=/w==",
    "/v1/rigs/%00",
    "/v1/rigs/..%2f..%2fetc",
    "/v1/audit?before=" + "9" * 400,
    "/v1/sessions?hash=" + "é" * 64,
)


def refused(answer: Any, begin_s: float) -> str:
    """The sentence of a refusal that came at once and was meant."""
    assert time.monotonic() - begin_s < LONGEST_S
    assert 400 <= answer.status_code < 500, answer.text[:500]
    assert answer.headers["content-type"] == "application/problem+json"
    detail = str(answer.json()["detail"])
    assert len(detail) < 900
    assert "\n" not in detail
    return detail


@pytest.mark.parametrize("route", ROUTES)
def test_no_json_is_refused(idle, route):
    client = idle()
    for name, body in JSON_BODIES.items():
        begin_s = time.monotonic()
        assert refused(sent(client, route, body, JSON), begin_s), name
    assert client.get("/healthz").status_code == 200


def test_no_route_takes_a_key_twice(idle):
    """Whatever it asks for: of two values one would be lost without a word."""
    client = idle()
    schema = client.get("/v1/openapi.json").json()
    routes = [
        (method, path.format(**dict.fromkeys(re.findall(r"{(\w+)}", path), ID)))
        for path, methods in schema["paths"].items()
        for method, route in methods.items()
        if JSON in route.get("requestBody", {}).get("content", {})
    ]
    assert len(routes) > 10
    for method, path in routes:
        body = b'{"a_key": 1, "a_key": 2}'
        answer = client.request(method, path, content=body, headers={"Content-Type": JSON})
        detail = refused(answer, time.monotonic())
        assert detail == "body must be JSON; key 'a_key' is given twice", (method, path, detail)


def test_odd_queries_are_refused_or_find_nothing(idle):
    client = idle()
    for query in QUERIES:
        begin_s = time.monotonic()
        answer = client.get(query)
        if answer.status_code == 200:
            assert answer.json() in ({"items": [], "next": None}, []), query
        else:
            refused(answer, begin_s)


def test_a_method_that_a_path_does_not_take_is_refused_with_those_that_it_takes(idle):
    client = idle()
    for path, allowed in (
        ("/v1/sessions", "GET, POST"),
        ("/v1/rigs/validate", "POST"),
        (f"/v1/rigs/{ID}", "GET"),
        (f"/v1/schedules/{ID}", "DELETE, GET"),
    ):
        answer = client.request("PATCH", path)
        assert answer.status_code == 405
        assert answer.headers["allow"] == allowed


def reading_lines(good: bytes) -> dict[str, bytes]:
    """Lines in place of a reading; `good` is one that would be taken."""
    reading = json.loads(good)

    def with_(**changes: Any) -> bytes:
        return json.dumps({**reading, **changes}).encode()

    return {
        "depth": DEEP,
        "many digits": good.replace(b'"sequence": 0', b'"sequence": ' + NINES),
        "a time of many digits": good.replace(b'"time_s": 0.0', b'"time_s": ' + NINES),
        "an endless time": good.replace(b'"time_s": 0.0', b'"time_s": 1e999'),
        "no time": good.replace(b'"time_s": 0.0', b'"time_s": NaN'),
        "a key twice": good.replace(b'"time_s": 0.0', b'"time_s": 0.0, "time_s": 1.0'),
        "half a character": good[:-1] + b', "\\ud800": 1}',
        "a truth for a number": with_(time_s=True),
        "a number in words": with_(time_s="1"),
        "half a number": with_(sequence=0.5),
        "a gap": with_(sequence=5),
        "a name in another alphabet": with_(field_T={"\u0430": [0, 0, 0]}),
        "a currents list": with_(current_A=[1.0]),
        "no line": b"",
        "too many lines": b"{}\n" * 10_001,
        "no object": b"[]",
        "half an object": b"{",
        "other bytes": b"\xff\xfe",
        "nothing but line feeds": b"\n" * 1000,
        "carriage returns": b"\r\r\r",
        "null characters": b"\0" * 1000,
    }


def test_lines_that_are_no_readings_are_refused_and_leave_the_session_as_it_was(
    idle, rig_text, small_session, small_rig
):
    client = idle()
    session_id = begin_session(client, upload_rig(client, rig_text))
    good = lines_of(small_session, small_rig, 0, 1)
    for name, line in reading_lines(good.rstrip()).items():
        begin_s = time.monotonic()
        assert refused(append(client, session_id, line + b"\n"), begin_s), name
        assert client.get(f"/v1/sessions/{session_id}").json()["n_readings"] == 0, name
    assert append(client, session_id, good).json()["n_readings"] == 1
    wrong_kind = sent(client, f"/v1/sessions/{session_id}/readings", b"{}", JSON)
    assert refusal(wrong_kind, 415)["value"] == JSON


def test_files_that_are_none_are_refused(idle, rig_text):
    client = idle()
    rig_id = upload_rig(client, rig_text)
    files = [DEEP, NINES, b"\0" * 1000, b"\xff" * 1000, b",".join([b"t_s"] * 10_000), b"a\n" * 200_000, b""]
    for kind, path in (
        (YAML, "/v1/rigs"),
        (YAML, "/v1/rigs/validate"),
        (CSV, f"/v1/sessions/import-csv?rig_id={rig_id}"),
        (ZIP, f"/v1/sessions/import-zip?rig_id={rig_id}"),
    ):
        for body in files:
            begin_s = time.monotonic()
            assert refused(sent(client, path, body, kind), begin_s)


def test_an_archive_that_claims_more_numbers_than_it_may_unpack_is_not_opened(
    idle, rig_text, small_session, tmp_path, monkeypatch
):
    """A missing chunk of 10^7 numbers would be made of nothing but its metadata."""
    client = idle(most_unpacked_MB=50.0)
    rig_id = upload_rig(client, rig_text)
    small_session.save(tmp_path / "small.zarr")
    file = tmp_path / "small.zarr" / "time_s" / "zarr.json"
    node = json.loads(file.read_text(encoding="utf-8"))
    grid = {"name": "regular", "configuration": {"chunk_shape": [10_000_000]}}
    file.write_text(json.dumps({**node, "shape": [10_000_000], "chunk_grid": grid}), encoding="utf-8")
    (tmp_path / "small.zarr" / "time_s" / "c" / "0").unlink()
    monkeypatch.setattr(zarr, "open_group", None)
    answer = send_zip(client, rig_id, zipped(tmp_path / "small.zarr"))
    assert "must hold at most 6250000 numbers" in refused(answer, time.monotonic())


def test_an_archive_with_a_name_twice_is_refused(idle, rig_text):
    client = idle()
    archive = zip_of({"zarr.json": b"{}", "zarr.jso2": b"{}"}).replace(b"zarr.jso2", b"zarr.json")
    answer = send_zip(client, upload_rig(client, rig_text), archive)
    assert "must hold each name once" in refused(answer, time.monotonic())
