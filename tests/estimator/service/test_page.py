"""The page comes from the service alone, runs nothing inline, and belongs to who logged in with a token."""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from fastapi import FastAPI
from starlette.testclient import TestClient

from estimator.service import serve
from estimator.service.app import create_app
from estimator.service.logins import MOST_AGE_S
from estimator.service.page_files import PAGE, page_files
from estimator.service.settings import Settings
from estimator.service.tokens import Scope, create_token, revoke_token
from tests.estimator.service.conftest import refusal

ADDRESS = "http://127.0.0.1:8765"
FROM_PAGE = {"Origin": ADDRESS}
FILES = {path: content.decode() for path, (content, _) in page_files().items()}


@pytest.fixture
def app(tmp_path: Path) -> Iterator[FastAPI]:
    made = create_app(Settings(data=tmp_path / "data", require_tokens=True), has_workers=False)
    yield made
    made.state.core.close()


@pytest.fixture
def browser(app: FastAPI) -> TestClient:
    """Keeps cookies, and does not start or end the service."""
    return TestClient(app, base_url=ADDRESS, raise_server_exceptions=False)


def log_in(app: FastAPI, browser: TestClient, scope: Scope = Scope.WRITE) -> tuple[str, str]:
    """The token's id, and the cookie as the browser is told of it."""
    token, token_id = create_token(app.state.core.database, "anne", scope, 1.0)
    answer = browser.post("/v1/login", json={"token": token}, headers=FROM_PAGE)
    assert answer.json() == {"user": "anne", "scope": str(scope)}
    assert token not in answer.headers["set-cookie"]
    return token_id, answer.headers["set-cookie"]


def test_every_file_of_the_folder_is_served_and_what_a_file_asks_for_is_there():
    root = files("estimator.service") / "page"
    named = {f.name for folder in ("", "vendor") for f in (root / folder).iterdir() if f.is_file()}
    served = {path.rpartition("/")[2] or "index.html" for path in FILES}
    assert named - served == {"lit-html.LICENSE"}
    for path, text in FILES.items():
        asked = re.findall(r"""from "(\./[^"]+)"|(?:src|href)="(/page/[^"]+)\"""", text)
        for relative, absolute in asked:
            folder = path.rpartition("/")[0]
            assert (absolute or f"{folder}/{relative[2:]}") in FILES, (path, relative, absolute)


def test_nothing_of_the_page_is_inline_or_comes_from_elsewhere():
    for path, text in FILES.items():
        if "/vendor/" in path:
            continue
        assert not re.search(r"<script(?![^>]*\bsrc=)|<style|\bstyle=|\son\w+=|javascript:", text), path
        assert set(re.findall(r"https?://[^\s\"'`]+", text)) <= {"http://www.w3.org/2000/svg"}, path
        assert not re.search(r"\beval\(|innerHTML|document\.write|unsafeHTML", text), path


def test_the_page_needs_no_token_and_its_policy_allows_its_own_files_only(browser):
    for path in FILES:
        answer = browser.get(path)
        assert answer.status_code == 200, path
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'; script-src 'self'; style-src 'self'" in policy
        assert "unsafe" not in policy
        tag = {"If-None-Match": answer.headers["etag"]}
        again = browser.get(path, headers=tag)
        assert (again.status_code, again.headers["content-security-policy"]) == (304, policy)
    refusal(browser.get("/v1/state"), 401)
    refusal(browser.get("/page/../app.js"), 401)
    refusal(browser.get("/page/missing.js"), 401)


def test_a_token_is_exchanged_for_a_cookie_that_scripts_cannot_read(app, browser):
    refusal(browser.post("/v1/login", json={"token": "wrong"}, headers=FROM_PAGE), 401)
    _, cookie = log_in(app, browser)
    assert {"HttpOnly", "SameSite=strict", "Path=/"} <= set(cookie.split("; "))
    assert "Secure" not in cookie
    assert browser.get("/v1/state").json()["user"] == "anne"
    assert browser.post("/v1/logout", headers=FROM_PAGE).status_code == 204
    refusal(browser.get("/v1/state"), 401)
    secure = TestClient(app, base_url="https://127.0.0.1:8765")
    token, _ = create_token(app.state.core.database, "ben", Scope.READ, 1.0)
    answer = secure.post("/v1/login", json={"token": token})
    assert "Secure" in answer.headers["set-cookie"].split("; ")


def test_a_cookie_changes_things_for_its_own_page_only(app, browser):
    log_in(app, browser)
    change: dict[str, Any] = {"content": b"{}", "headers": {"Content-Type": "application/yaml"}}
    assert refusal(browser.post("/v1/rigs", **change), 403)["thing"] == "origin"
    change["headers"]["Origin"] = "http://127.0.0.1:9999"  # same site, another service
    assert refusal(browser.post("/v1/rigs", **change), 403)["thing"] == "origin"
    change["headers"] |= FROM_PAGE
    refusal(browser.post("/v1/rigs", **change), 422)
    change["headers"]["Sec-Fetch-Site"] = "same-site"
    assert refusal(browser.post("/v1/rigs", **change), 403)["thing"] == "site"


def test_a_cookie_allows_what_its_token_allows_and_ends_with_it(app, browser):
    token_id, _ = log_in(app, browser, Scope.READ)
    body = {"content": b"{}", "headers": {"Content-Type": "application/yaml", **FROM_PAGE}}
    assert refusal(browser.post("/v1/rigs", **body), 403)["rule"] == "must have the scope write"
    revoke_token(app.state.core.database, token_id)
    assert refusal(browser.get("/v1/state"), 401)["thing"] == "login"


def test_a_cookie_that_is_altered_or_a_month_old_is_refused(app, browser, monkeypatch):
    log_in(app, browser)
    ((name, value),) = browser.cookies.items()
    plain = TestClient(app, base_url=ADDRESS)
    assert plain.get("/v1/state", headers={"Cookie": f"{name}={value}"}).status_code == 200
    for other in (value[:-1], f"x{value}", value.split(".")[0], "", value.swapcase()):
        refusal(plain.get("/v1/state", headers={"Cookie": f"{name}={other}"}), 401)
    refusal(plain.get("/v1/state", headers={"Cookie": f"other={value}"}), 401)
    later_s = time.time() + MOST_AGE_S + 10
    monkeypatch.setattr("itsdangerous.timed.time.time", lambda: later_s)
    refusal(plain.get("/v1/state", headers={"Cookie": f"{name}={value}"}), 401)


def test_logins_outlive_the_service_and_belong_to_one(app, tmp_path):
    cookies = app.state.core.cookies
    key = tmp_path / "data" / "page.key"
    assert key.stat().st_mode & 0o777 == 0o600
    again = type(cookies)(tmp_path / "data")
    signed = cookies._signer.sign("abc").decode()
    assert (again.name, again.login_id(f"{again.name}={signed}")) == (cookies.name, "abc")
    (tmp_path / "other").mkdir()
    other = type(cookies)(tmp_path / "other")
    assert other.name != cookies.name
    assert other.login_id(f"{other.name}={signed}") is None


def test_a_link_of_another_site_opens_the_page_and_nothing_else(idle):
    loopback = idle()
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate"}
    assert loopback.get(PAGE, headers=link).status_code == 200
    refusal(loopback.get("/v1/state", headers=link), 403)
    refusal(loopback.get(PAGE, headers={**link, "Sec-Fetch-Mode": "no-cors"}), 403)


def until_the_browser_is_open(_: object, sockets: list[socket.socket]) -> None:
    time.sleep(0.2)
    for listener in sockets:
        listener.close()


def test_serve_shows_the_page_where_that_is_asked_for(tmp_path, monkeypatch):
    opened: list[str] = []
    told: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr(serve, "create_app", lambda _: SimpleNamespace(state=SimpleNamespace(core=None)))
    monkeypatch.setattr("uvicorn.Server.run", until_the_browser_is_open)
    monkeypatch.setattr(serve, "install_logs", lambda: None)
    for opens in (False, True):
        data = tmp_path / str(opens)
        serve.serve(Settings(data=data, port=0), told.append, opens)
    assert opened == told[1:]
    assert re.fullmatch(r"http://127\.0\.0\.1:\d+", opened[0])
