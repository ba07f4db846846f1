"""Every route refuses who may not use it, found from the route table; hosts, origins, bodies and tokens have limits."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from fastapi import FastAPI
from sqlalchemy import select, update
from starlette.testclient import TestClient

from estimator.cli.main import main
from estimator.errors import InvalidInput
from estimator.service.app import create_app, scopes_by_route
from estimator.service.database import Database, new_id
from estimator.service.guard import PUBLIC
from estimator.service.page_files import page_files
from estimator.service.routes import operation
from estimator.service.schema import Audit, Token
from estimator.service.settings import Settings, load_settings
from estimator.service.tokens import Scope, caller_of, create_token, revoke_token
from tests.estimator.service.conftest import JSON, YAML, refusal, upload_rig

ADDRESS = "http://10.1.2.3:8765"


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> FastAPI:
    settings = Settings(
        data=tmp_path_factory.mktemp("guarded") / "data",
        host="10.1.2.3",
        most_body_MB=0.1,
        most_refused_per_minute=10_000,
    )
    return create_app(settings, has_workers=False)


@pytest.fixture(scope="module")
def client(app: FastAPI) -> Iterator[TestClient]:
    with TestClient(app, base_url=ADDRESS, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="module")
def tokens(app: FastAPI) -> dict[str, str]:
    """A token of each scope, and those that are no longer valid."""
    database: Database = app.state.core.database
    made = {str(scope): create_token(database, f"user-{scope}", scope, 1.0)[0] for scope in Scope}
    made["expired"], expired_id = create_token(database, "late", Scope.ADMIN, 1.0)
    made["revoked"], revoked_id = create_token(database, "gone", Scope.ADMIN, 1.0)
    revoke_token(database, revoked_id)
    past = (datetime.now(UTC) - timedelta(seconds=1)).isoformat(timespec="milliseconds")
    with database.writing() as db:
        db.execute(update(Token).where(Token.id == expired_id).values(expires=past))
    return made


def routes() -> list[tuple[str, str, Scope | None]]:
    with tempfile.TemporaryDirectory() as folder:
        made = create_app(Settings(data=Path(folder)), has_workers=False)
        found = [(method, path, scope) for (method, path), scope in scopes_by_route(made).items()]
        made.state.core.close()
    return found


ROUTES = routes()


def ask(client: TestClient, method: str, path: str, token: str | None) -> Any:
    concrete = re.sub(r"\{\w+\}", new_id(), path)
    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    return client.request(method, concrete, headers=headers)


def test_the_table_holds_every_path_of_the_schema(app):
    documented = {(method.upper(), path) for path, item in app.openapi()["paths"].items() for method in item}
    hidden = {("GET", path) for path in ("/v1/openapi.json", *page_files())}
    assert documented | hidden == {(method, path) for method, path, _ in ROUTES}
    assert len(ROUTES) > 30


@pytest.mark.parametrize(("method", "path", "scope"), ROUTES, ids=str)
def test_every_route_refuses_tokens_that_are_missing_wrong_expired_or_too_weak(
    client, tokens, method, path, scope
):
    if path in PUBLIC:
        assert scope is None
        return
    assert scope is not None
    for token in (None, "", "wrong", tokens["read"][:-1], tokens["expired"], tokens["revoked"]):
        answer = ask(client, method, path, token)
        assert refusal(answer, 401)["thing"] == "token"
        assert answer.headers["www-authenticate"].startswith("Bearer")
    for weaker in Scope:
        answer = ask(client, method, path, tokens[weaker])
        if weaker.includes(scope):
            assert answer.status_code not in (401, 403)
        else:
            assert refusal(answer, 403)["rule"] == f"must have the scope {scope}"


def test_changes_need_more_than_read():
    predictions = {f"/v1/calibrations/{{calibration_id}}/{name}" for name in ("predict", "grid")}
    harmless = {"/v1/rigs/validate", *predictions, *(f"{path}.arrow" for path in predictions)}
    harmless |= {"/v1/login", "/v1/logout", "/v1/calibrations/{calibration_id}/export"}
    harmless |= {"/v1/sessions/{session_id}/next", "/v1/sessions/preview-csv"}
    for method, path, scope in ROUTES:
        if method != "GET" and path not in harmless:
            assert scope is not None, path
            assert scope.includes(Scope.WRITE), path


def test_an_application_with_a_route_without_scope_is_not_made(tmp_path):
    forgotten = operation.router
    before = list(forgotten.routes)

    def answer() -> dict[str, int]:
        return {}

    forgotten.add_api_route("/v1/forgotten", answer)
    try:
        with pytest.raises(RuntimeError, match="/v1/forgotten"):
            create_app(Settings(data=tmp_path / "data"), has_workers=False)
    finally:
        forgotten.routes[:] = before


def test_paths_that_are_not_there_need_a_token_too(client, tokens):
    refusal(ask(client, "GET", "/v1/nothing", None), 401)
    assert refusal(ask(client, "GET", "/v1/nothing", tokens["read"]), 404)["thing"] == "path"
    assert refusal(ask(client, "DELETE", "/v1/rigs", tokens["admin"]), 405)["value"] == "DELETE"
    refusal(ask(client, "GET", "/healthz/", None), 401)


def test_tokens_are_kept_as_hashes_and_changes_are_audited(app, client, tokens, rig_text):
    stored = b"".join(path.read_bytes() for path in app.state.core.data.glob("coilcal.sqlite*"))
    assert not any(token.encode() in stored for token in tokens.values())
    client.headers["Authorization"] = f"Bearer {tokens['write']}"
    try:
        rig_id = upload_rig(client, rig_text)
    finally:
        del client.headers["Authorization"]
    with app.state.core.database.reading() as db:
        entry = db.scalars(select(Audit).where(Audit.action == "rig.upload")).one()
    assert (entry.user, entry.target) == ("user-write", rig_id)
    assert entry.token_id is not None
    listed = ask(client, "GET", "/v1/audit", tokens["admin"]).json()
    assert (listed[0]["action"], listed[0]["target"]) == ("rig.upload", rig_id)


@pytest.mark.parametrize(
    ("headers", "thing"),
    [
        ({"Host": "attacker.example"}, "host"),
        ({"Host": ""}, "host"),
        ({"Origin": "https://attacker.example"}, "origin"),
        ({"Origin": "null"}, "origin"),
        ({"Sec-Fetch-Site": "cross-site"}, "site"),
    ],
)
def test_pages_of_other_sites_reach_nothing(idle, headers, thing):
    """At loopback there are no tokens, but browsers of this computer visit other sites."""
    loopback = idle()
    assert refusal(loopback.get("/v1/state", headers=headers), 403)["thing"] == thing
    answer = loopback.get(
        "/v1/state", headers={"Origin": "http://127.0.0.1:8765", "Sec-Fetch-Site": "same-origin"}
    )
    assert answer.json()["user"] == "local"
    assert "access-control-allow-origin" not in answer.headers
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_bodies_are_limited_whatever_they_claim(client, tokens):
    headers = {"Authorization": f"Bearer {tokens['write']}", "Content-Type": YAML}
    in_pieces = [b"a" * 50_000] * 3
    for path, body, kind in (
        ("/v1/rigs", b"a" * 100_001, YAML),
        ("/v1/rigs", iter(in_pieces), YAML),
        ("/v1/sessions", iter(in_pieces), JSON),
    ):
        answer = client.post(path, content=body, headers={**headers, "Content-Type": kind})
        assert refusal(answer, 413)["thing"] == "body"
    encoded = {**headers, "Content-Encoding": "gzip"}
    assert refusal(client.post("/v1/rigs", content=b"a", headers=encoded), 415)["value"] == "gzip"
    refusal(client.post("/v1/rigs", content=b"a" * 100_001), 401)  # before the body is looked at


def test_loopback_alone_needs_no_tokens():
    assert not Settings().needs_tokens
    assert not Settings(host="::1").needs_tokens
    assert not Settings(host="localhost").needs_tokens
    assert all(Settings(host=host).needs_tokens for host in ("0.0.0.0", "::", "192.168.0.1", "lab.example"))
    assert Settings(require_tokens=True).needs_tokens


def test_tokens_have_names_and_times(tmp_path):
    database = Database(tmp_path / "tokens.sqlite")
    database.migrate()
    for user, days in (
        ("", 1.0),
        ("a b", 1.0),
        ("x" * 65, 1.0),
        ("anne", 0.0),
        ("anne", 1e9),
        ("anne", float("nan")),
    ):
        with pytest.raises(InvalidInput):
            create_token(database, user, Scope.READ, days)
    secret, token_id = create_token(database, "anne", Scope.READ, 1.0)
    caller = caller_of(database, secret)
    assert caller is not None
    assert (caller.user, caller.scope, caller.token_id) == ("anne", Scope.READ, token_id)
    database.close()


def test_settings_come_from_file_and_environment_and_name_what_is_wrong(tmp_path):
    path = tmp_path / "service.yaml"
    path.write_text("host: 0.0.0.0\nmost_job_hours: 3\nallowed_hosts: [lab.example]\n", encoding="utf-8")
    settings = load_settings(
        path,
        {
            "COILCAL_SERVE_PORT": "9000",
            "COILCAL_SERVE_MOST_JOB_HOURS": "2.5",
            "COILCAL_SERVE_REQUIRE_TOKENS": "true",
        },
    )
    assert (settings.host, settings.port, settings.most_job_hours) == ("0.0.0.0", 9000, 2.5)
    assert (settings.allowed_hosts, settings.require_tokens) == (("lab.example",), True)
    for text, words in (
        ("prot: 1", "prot is not a known key; the closest is port"),
        ("port: high", "port must be a whole number; received 'high'"),
        ("host: ''\nport: 70000", f"port must be from 0 to 65535; received 70000 ({path}, line 2)"),
        ("most_queued: 0", "most_queued must be > 0"),
        ("tls_key: key.pem", "must be given together"),
        ("allowed_hosts: lab.example", "allowed_hosts must be a list of words"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InvalidInput, match=re.escape(words)):
            load_settings(path, {})
    for number in ("many", "-1"):
        with pytest.raises(InvalidInput, match="COILCAL_SERVE_WORKERS"):
            load_settings(None, {"COILCAL_SERVE_WORKERS": number})
    with pytest.raises(InvalidInput, match=re.escape("received -1.0 (option --keep-jobs-days)")):
        load_settings(None, {}).with_options(keep_jobs_days=-1.0)


def test_the_command_makes_lists_and_revokes_tokens_and_needs_one_beyond_loopback(tmp_path):
    def run(*words: str) -> Any:
        return CliRunner().invoke(main, ["serve", *words, "--data", str(tmp_path / "data")])

    def check() -> Any:
        return run("--host", "0.0.0.0", "--check")

    refused = check()
    assert refused.exit_code == 2
    assert "tokens must be there before the service starts" in refused.stderr
    assert not (tmp_path / "data").exists()
    made = run("token", "create", "--user", "anne", "--scope", "read")
    assert made.exit_code == 0
    assert re.fullmatch(r"coilcal_[\w-]{43}\n", made.stdout)
    listed = run("token", "list")
    token_id = listed.stdout.splitlines()[1].split()[0]
    assert made.stdout.strip() not in listed.stdout
    assert "needed; 1 are valid" in check().stdout
    assert run("token", "revoke", token_id).exit_code == 0
    assert run("token", "revoke", "nope").exit_code == 2
    assert check().exit_code == 2
