"""`coilcal --via local`: a process of `coilcal serve`, which has all libraries loaded, carries the command out.

Here the command is parsed and waited for. Its folder, environment and standard streams go there, and so do Ctrl-C, SIGTERM and Ctrl-Z.
Where the result could be another one, or nobody is there, the command runs here.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
from contextlib import suppress
from typing import Any, NoReturn

import click
from click.core import ParameterSource

from estimator.cli.local_socket import address, circumstances, is_own, opened_folder, send_request
from estimator.cli.without_torch import is_numpy_enough
from estimator.errors import InvalidInput

# The others measure, serve, start processes of their own, or ask.
COMMANDS = frozenset(
    {
        *("calibrate", "check", "compare", "design", "diagnose", "export", "import", "multipoles"),
        *("plan", "predict", "report", "show", "simulate"),
    }
)
KINDS = ("numpy", "torch")
CARRIED_OUT = "carried out"  # what click passes on in a process that carries a command out
LOADED_S = 60.0  # in which the libraries of the first command are loaded
PASSED_ON = (signal.SIGINT, signal.SIGTERM, signal.SIGTSTP, signal.SIGCONT)
EXIT_LOST = 130  # as after an interruption


def carry_out(context: click.Context, takes_derivatives: bool) -> None:
    """Let the command be carried out there and end with its exit code; return where it has to run here.

    Args:
        context: Of the command, whose arguments are valid.
        takes_derivatives: It needs torch.
    """
    root = context.find_root()
    if not _is_meant(context, root):
        return
    kind = "torch" if takes_derivatives or not is_numpy_enough(context.params) else "numpy"
    try:
        with _connected(kind) as connection:
            difference = _difference(connection)
            if not difference:
                _end(_carried_out(connection, context.meta["coilcal.given"]))
    except InvalidInput as error:
        difference = str(error)
    except (OSError, ValueError):
        if root.get_parameter_source("via") is not ParameterSource.COMMANDLINE:
            return
        difference = "no coilcal serve of yours answers on this computer"
    click.echo(f"coilcal: the command runs here, since {difference}", err=True)


def _is_meant(context: click.Context, root: click.Context) -> bool:
    """Whether a command is to be carried out there: one that computes on a processor, with one thread for an operation."""
    if root.obj is not None or context.parent is not root:
        return False
    if root.params["threads"] != 1 or context.params.get("device", "cpu") != "cpu":
        return False
    try:
        for stream in (sys.stdin, sys.stdout, sys.stderr):
            stream.fileno()
    except (AttributeError, OSError, ValueError):  # closed, or none of the system's
        return False
    return context.command.name in COMMANDS


def _connected(kind: str) -> socket.socket:
    """A connection to a process of this user.

    Raises:
        InvalidInput: Somebody else is there.
        OSError: Nobody is there.
    """
    if sys.platform != "linux":
        raise InvalidInput("--via local must run on Linux")
    folder, connection = opened_folder(), socket.socket(socket.AF_UNIX)
    try:
        connection.settimeout(LOADED_S)
        connection.connect(address(folder, kind))
        if not is_own(connection):
            raise InvalidInput("the process at the socket is another user's")
    except BaseException:
        connection.close()
        raise
    finally:
        os.close(folder)
    return connection


def _difference(connection: socket.socket) -> str:
    """What is different there, as the end of a sentence; nothing where the result is the same."""
    with connection.makefile("rb") as answers:
        there, here = json.loads(answers.readline()), json.loads(json.dumps(circumstances()))
    differing = [name for name, value in here.items() if there.get(name) != value]
    if "environment" in differing:
        differing.remove("environment")
        then, now = there["environment"], here["environment"]
        differing += sorted(name for name in then | now if then.get(name) != now.get(name))
    if there.get("changed"):
        return "files of coilcal or of a library have changed since coilcal serve loaded them: start it again"
    return f"coilcal serve has another {', '.join(differing)}" if differing else ""


def _carried_out(connection: socket.socket, arguments: list[str]) -> int | None:
    """Have the command carried out: how its process ended, as `os.wait` tells it; None where that was lost."""
    here = os.open(".", os.O_PATH | os.O_DIRECTORY)
    streams = [sys.stdin, sys.stdout, sys.stderr]
    os.umask(umask := os.umask(0o77))
    request: dict[str, Any] = {
        "arguments": arguments,
        "words": [sys.argv, sys.orig_argv],
        "streams": [[stream.encoding, stream.errors] for stream in streams],
        "variables": dict(os.environ),
        "umask": umask,
        "cores": sorted(os.sched_getaffinity(0)),
        "nice": os.nice(0),
    }
    connection.settimeout(None)
    send_request(connection, request, [*(stream.fileno() for stream in streams), here])
    _pass_on(connection)
    with connection.makefile("rb") as answers, suppress(OSError, ValueError):
        return json.loads(answers.readline())
    return None


def _pass_on(connection: socket.socket) -> None:
    """Send signals to the command from now on. After Ctrl-Z this process stops itself, too, until the shell lets it go on."""

    def passed_on(number: int, _: object) -> None:
        with suppress(OSError):
            connection.send(bytes([number]))
        if number == signal.SIGTSTP:
            signal.raise_signal(signal.SIGSTOP)

    for number in PASSED_ON:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, passed_on)


def _end(status: int | None) -> NoReturn:
    """End as the command did."""
    if status is None:
        click.echo("coilcal: coilcal serve ended before the command; give the command again", err=True)
        sys.exit(EXIT_LOST)
    exit_code = os.waitstatus_to_exitcode(status)
    if exit_code < 0:
        with suppress(OSError):
            signal.signal(-exit_code, signal.SIG_DFL)
        os.kill(os.getpid(), -exit_code)
    sys.exit(exit_code)
