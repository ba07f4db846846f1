"""What a hostile student would send: each request is refused in the form of refusals, and the service answers the next one."""

from __future__ import annotations

import asyncio
import shutil
import zipfile
from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from estimator.service import archives
from estimator.service.concurrency import WaitingLimit
from estimator.service.problems import Problem
from estimator.store.zipped import zipped
from tests.estimator.service.conftest import (
    CSV,
    JSON,
    YAML,
    ZIP,
    refusal,
    send_zip,
    sent,
    upload_rig,
    zip_of,
)

LOOPBACK = "http://127.0.0.1:8765"


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    from estimator.service.app import create_app
    from estimator.service.settings import Settings

    data = tmp_path_factory.mktemp("attacked") / "data"
    app = create_app(Settings(data=data, most_body_MB=1.0, most_unpacked_MB=5.0), has_workers=False)
    with TestClient(app, base_url=LOOPBACK, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def rig_id(client: TestClient, rig_text: str) -> str:
    return upload_rig(client, rig_text)


RIGS = {
    "aliases that unfold": "a: &a [x,x,x,x,x,x,x,x,x]\n"
    + "".join(f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(9)),
    "an object": "!!python/object/apply:os.system ['id']",
    "an endless number": "schema_version: " + "9" * 10_000,
    "half a character": 'schema_version: 1\nname: "\\ud800"\n',
    "a name with a zero": 'schema_version: 1\nname: "a\\0b"\n',
    "merge keys": "<<: [" + ",".join(["{a: 1}"] * 20_000) + "]",
}
PATHS = (
    "/page/../../coilcal.sqlite",
    "/page/..%2f..%2fcoilcal.sqlite",
    "/page/%2e%2e/%2e%2e/etc/passwd",
    "/page//etc/passwd",
    "/v1/sessions/..%2f..%2fcoilcal.sqlite",
    "/v1/sessions/%00",
    "/v1/jobs/" + "a" * 5000,
)


@pytest.fixture(autouse=True)
def lives_on(client: TestClient) -> Iterator[None]:
    """After each attack the service answers, and has left nothing where archives are unpacked."""
    yield
    assert client.get("/healthz").status_code == 200
    uploads = client.app.state.core.uploads
    assert not uploads.exists() or not list(uploads.iterdir())


@pytest.mark.parametrize("name", RIGS)
def test_a_rig_is_refused(client, name):
    for path in ("/v1/rigs", "/v1/rigs/validate"):
        refusal(sent(client, path, RIGS[name], YAML), 422)


@pytest.mark.parametrize("path", PATHS)
def test_a_path_leads_nowhere(client, path):
    answer = client.get(path)
    assert refusal(answer, answer.status_code)["status"] in (404, 422)
    assert b"root:" not in answer.content
    assert b"SQLite" not in answer.content


def test_members_are_counted_before_a_list_of_them_is_made(client, rig_id, monkeypatch):
    """600,000 members of 50 bytes took half a gigabyte and seconds in which nothing else was answered."""
    flood = zip_of({f"{n}": b"" for n in range(archives.MOST_MEMBERS + 1)}, method=zipfile.ZIP_STORED)
    monkeypatch.setattr(archives.zipfile, "ZipFile", None)
    problem = refusal(send_zip(client, rig_id, flood), 413)
    assert problem["rule"] == "must hold at most 5000 files"


def test_readings_that_an_archive_claims_and_does_not_hold_are_counted_before_they_are_made_up(
    idle, rig_text, small_session, readings_csv, tmp_path, monkeypatch
):
    """Seven kilobytes without a chunk became a session of three million readings, in half a gigabyte."""
    client = idle(most_readings=len(small_session.observations) - 1)
    rig_id = upload_rig(client, rig_text)
    small_session.save(tmp_path / "s.zarr")
    for chunks in (tmp_path / "s.zarr").glob("*/c"):
        shutil.rmtree(chunks)
    archive = zipped(tmp_path / "s.zarr")
    monkeypatch.setattr(archives, "load_session", None)
    n = len(small_session.observations)
    problem = refusal(send_zip(client, rig_id, archive), 413)
    assert (problem["rule"], problem["value"]) == (f"must have at most {n - 1} readings", str(n))
    refusal(sent(client, f"/v1/sessions/import-csv?rig_id={rig_id}", readings_csv, CSV), 413)


def test_few_sessions_are_imported_at_once_and_the_others_wait_without_a_thread():
    async def crowd() -> tuple[int, int, int]:
        room, at_work, is_over, refused = WaitingLimit("sessions", 2, 3), [0], asyncio.Event(), 0
        counts: list[int] = []

        async def one() -> None:
            async with room.taken():
                at_work[0] += 1
                counts.append(at_work[0])
                await is_over.wait()
                at_work[0] -= 1

        tasks = [asyncio.create_task(one()) for _ in range(5)]
        await asyncio.sleep(0)
        for _ in range(4):
            try:
                async with asyncio.timeout(0.01), room.taken():
                    pass
            except Problem:
                refused += 1
        is_over.set()
        await asyncio.gather(*tasks)
        return max(counts), len(counts), refused

    assert asyncio.run(crowd()) == (2, 5, 4)


def test_imports_stand_in_that_line(idle, rig_text, readings_csv):
    client = idle()
    rig_id = upload_rig(client, rig_text)
    client.app.state.core.importing = WaitingLimit("sessions to import", 1, 0)
    for name, body, kind in (("csv", readings_csv, CSV), ("zip", b"PK", ZIP)):
        answer = sent(client, f"/v1/sessions/import-{name}?rig_id={rig_id}", body, kind)
        assert refusal(answer, 429)["thing"] == "sessions to import"
        assert answer.headers["Retry-After"] == "10"


def test_names_are_words_and_no_headers(client, rig_id):
    """What somebody calls a session comes back as text, and in no header."""
    words = "<script>alert(1)</script>\r\nSet-Cookie: a=b"
    session = client.post("/v1/sessions", json={"rig_id": rig_id, "source": words})
    assert session.status_code == 201
    answer = client.get(f"/v1/sessions/{session.json()['id']}")
    assert answer.json()["source"] == words
    assert answer.headers["content-type"] == JSON
    assert "set-cookie" not in answer.headers
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_guesses_at_the_login_are_counted_as_guesses(idle):
    guarded = idle(require_tokens=True, most_refused_per_minute=3)
    answers = [guarded.post("/v1/login", json={"token": f"guess {n}"}).status_code for n in range(5)]
    assert answers == [401, 401, 401, 429, 429]
    headers = {"Authorization": "Bearer guess"}
    assert guarded.get("/v1/rigs", headers=headers).status_code == 429


def test_no_user_takes_the_event_streams_of_all(idle):
    core = idle(most_streams=4, most_streams_per_user=2).app.state.core
    with core.streams.taken("anne"), core.streams.taken("anne"), core.streams.taken("bert"):
        with pytest.raises(Problem, match="event streams of anne must be at most 2"):
            core.streams.taken("anne").__enter__()
        with core.streams.taken("bert"), pytest.raises(Problem, match="event streams must be at most 4"):
            core.streams.taken("carl").__enter__()
        assert core.streams.n_taken() == 3
    assert core.streams.n_taken() == 0
