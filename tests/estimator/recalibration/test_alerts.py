"""Alerts arrive as JSON, and one that fails is a sentence, never an exception."""

from __future__ import annotations

import json
import re
import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

import pytest

from estimator.errors import InvalidInput
from estimator.recalibration.alerts import post, run_command, senders

MESSAGE = {"conclusion": "drifted", "reason": "axis_gain (x 0.01)"}


@pytest.mark.parametrize(
    "command", ["no-such-command", f"{sys.executable} -c 'raise SystemExit(3)'", "'", ""]
)
def test_a_command_that_fails_is_told_in_one_sentence(command):
    problem = run_command(command, MESSAGE)
    assert problem is not None
    assert problem.startswith("alert command ")


def test_a_command_for_a_shell_is_told_how_to_get_one_and_that_works(tmp_path):
    problem = run_command(f"cat >> {tmp_path}/alerts.log", MESSAGE)
    assert problem is not None
    hint = problem.partition("; it runs without a shell, so write ")[2]
    assert hint == f"sh -c 'cat >> {tmp_path}/alerts.log'"
    assert run_command(hint, MESSAGE) is None
    assert json.loads((tmp_path / "alerts.log").read_text(encoding="utf-8")) == MESSAGE


@pytest.mark.parametrize("command", ["cat >> alerts.log", "cat | mail root", "tee a 2> b", "true && date"])
def test_a_command_that_needs_a_shell_is_refused_before_the_first_alert(command):
    words = f"alert command must need no shell; received {command!r}; it runs without a shell, so write sh -c '{command}'"
    with pytest.raises(InvalidInput, match=re.escape(words)):
        senders(command, None)
    assert len(senders(f"sh -c '{command}'", None)) == 1


def test_webhook_gets_the_message_and_a_dead_one_is_told():
    received: list[Any] = []

    class Hook(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            received.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Hook)
    url = f"http://127.0.0.1:{server.server_port}/"
    thread = threading.Thread(target=server.handle_request)
    thread.start()
    assert post(url, MESSAGE) is None
    thread.join(10)
    server.server_close()
    assert received == [MESSAGE]
    problem = post(url, MESSAGE)
    assert problem is not None
    assert problem.startswith(f"alert to {url} failed: ")


def test_only_what_was_asked_for_is_sent_and_other_addresses_are_refused():
    assert senders(None, None) == []
    assert len(senders("true", "http://127.0.0.1/")) == 2
    with pytest.raises(
        InvalidInput, match="webhook must be an http or https address; received 'file:///tmp'"
    ):
        senders(None, "file:///tmp")
