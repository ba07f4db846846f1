"""Telling somebody: a command that gets JSON on its standard input, or a webhook that it is posted to. Never fatal."""

from __future__ import annotations

import json
import shlex
import subprocess
import urllib.request
from collections.abc import Callable, Mapping
from typing import Any

from estimator.errors import InvalidInput
from estimator.recalibration import policy


def run_command(command: str, message: Mapping[str, Any]) -> str | None:
    """Run a command with a message on its standard input.

    Returns: What went wrong, in one sentence; None where nothing did.
    """
    try:
        done = subprocess.run(
            shlex.split(command),
            input=json.dumps(message).encode(),
            capture_output=True,
            timeout=policy.ALERT_TIMEOUT_S,
            check=False,
        )
    except (OSError, ValueError, IndexError, subprocess.TimeoutExpired) as error:
        return f"alert command {command!r} failed: {error}"
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip()
        return f"alert command {command!r} ended with exit code {done.returncode}: {said}"
    return None


def post(url: str, message: Mapping[str, Any]) -> str | None:
    """Post a message to a webhook.

    Returns: What went wrong, in one sentence; None where nothing did.
    """
    request = urllib.request.Request(
        url, json.dumps(message).encode(), {"Content-Type": "application/json"}, method="POST"
    )
    try:
        with urllib.request.urlopen(request, timeout=policy.ALERT_TIMEOUT_S):
            return None
    except (OSError, ValueError) as error:
        return f"alert to {url} failed: {error}"


def senders(command: str | None, webhook: str | None) -> list[Callable[[Mapping[str, Any]], str | None]]:
    """The ways that a user asked for.

    Raises:
        InvalidInput: The webhook is no http address.
    """
    if webhook is not None and not webhook.startswith(("http://", "https://")):
        raise InvalidInput(f"webhook must be an http or https address; received {webhook!r}")
    found: list[Callable[[Mapping[str, Any]], str | None]] = []
    if command is not None:
        found.append(lambda message: run_command(command, message))
    if webhook is not None:
        found.append(lambda message: post(webhook, message))
    return found
