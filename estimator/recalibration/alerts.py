"""Alerts as JSON, to the standard input of a command or to a webhook. A failed alert is reported, never raised."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import urllib.request
from collections.abc import Callable, Mapping
from typing import Any

from estimator.errors import InvalidInput
from estimator.recalibration import policy
from estimator.recalibration.conclusion import IS_CONVERGED
from estimator.recalibration.log import Entry


def calls_for_action(entry: Entry) -> bool:
    """Whether a conclusion needs action: a drift, a rejection, or a calibration that did not converge."""
    return entry.conclusion in ("drifted", "rejected") or entry.checks.get(IS_CONVERGED) is False


def run_command(command: str, message: Mapping[str, Any]) -> str | None:
    """Run a command with a message on its standard input.

    Returns: The failure in one sentence; None if there was none.
    """
    try:
        process = subprocess.run(
            shlex.split(command),
            input=json.dumps(message).encode(),
            capture_output=True,
            timeout=policy.ALERT_TIMEOUT_S,
            check=False,
        )
    except (OSError, ValueError, IndexError, subprocess.TimeoutExpired) as error:
        return f"alert command {command!r} failed: {error}{_shell_hint(command)}"
    if process.returncode:
        output = process.stderr.decode(errors="replace").strip()
        return f"alert command {command!r} ended with exit code {process.returncode}: {output}{_shell_hint(command)}"
    return None


def _shell_hint(command: str) -> str:
    """What to write instead, if the command has what only a shell understands."""
    if not re.search(r"[|&;<>$`*]", command):
        return ""
    return f"; it runs without a shell, so write {'sh -c ' + shlex.quote(command)}"


def _needs_shell(command: str) -> bool:
    """Whether a word is a pipe or a redirection, which a program would take for a name."""
    try:
        words = shlex.split(command)
    except ValueError:
        return False
    return any(re.fullmatch(r"\d?(>>?|<|\||\|\||&&|;|&)(&\d)?", word) for word in words)


def post(url: str, message: Mapping[str, Any]) -> str | None:
    """Post a message to a webhook.

    Returns: The failure in one sentence; None if there was none.
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
    """Functions that send a message to the command and the webhook, if they are given.

    Raises:
        InvalidInput: The webhook is not an http address, or the command needs a shell.
    """
    if command is not None and _needs_shell(command):
        raise InvalidInput(f"alert command must need no shell; received {command!r}{_shell_hint(command)}")
    if webhook is not None and not webhook.startswith(("http://", "https://")):
        raise InvalidInput(f"webhook must be an http or https address; received {webhook!r}")
    send: list[Callable[[Mapping[str, Any]], str | None]] = []
    if command is not None:
        send.append(lambda message: run_command(command, message))
    if webhook is not None:
        send.append(lambda message: post(webhook, message))
    return send
