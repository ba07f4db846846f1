"""What the cells of tutorials use: a terminal, files, and the pictures that a reader sees in the pages that `coilcal` writes.

IPython's own `%%sh` hands on what a program prints in pieces, in the middle of lines, and standard error after standard output.
It also takes the exit code of the last program of a pipe, and of the last line of a cell, for that of all.
"""

from __future__ import annotations

import argparse
import atexit
import base64
import html
import os
import re
import shlex
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import IO, TYPE_CHECKING

from IPython.core.error import UsageError
from IPython.core.magic import register_cell_magic
from IPython.display import Image

if TYPE_CHECKING:
    from estimator import Diagnosis

FIRST = Path(__file__).parents[1] / "tutorials" / "first-calibration.md"
WRITTEN = re.compile(r"^%%writefile (\S+)\n(.*?)^```", re.DOTALL | re.MULTILINE)
PICTURE = re.compile(r'<img src="data:image/png;base64,([^"]+)" alt="([^"]*)">')


CELL_S = 900.0  # after which a command is taken to hang: several times what the longest needs beside busy processes
SAID = 15  # last lines of a failed command that the error quotes

_options = argparse.ArgumentParser(prog="%%sh")
_options.add_argument("--first", type=int, help="lines of the output that are shown, from its beginning")
_options.add_argument("--last", type=int, help="lines of the output that are shown, from its end")
_options.add_argument("--results", action="store_true", help="show standard output only, and no progress")


class CommandFailed(UsageError):  # which IPython reports without a traceback
    """A command of a tutorial failed, or hung; the message holds it, its exit code and its last lines."""


@register_cell_magic
def sh(options: str, cell: str) -> None:
    """Run commands as a terminal does, and print what they print, or of that what the options choose.

    Raises:
        CommandFailed: A command failed, at any place of a pipe, or took longer than `CELL_S`. This stops the building of the site.
    """
    shown = _options.parse_args(shlex.split(options))
    command = ["bash", "-e", "-o", "pipefail", "-c", cell]
    with tempfile.TemporaryFile("w+", encoding="utf-8") as progress:
        errors = progress if shown.results else subprocess.STDOUT
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=errors, text=True, start_new_session=True
        ) as running:
            try:
                said, _ = running.communicate(timeout=CELL_S)
            except subprocess.TimeoutExpired:
                os.killpg(running.pid, signal.SIGKILL)
                said, _ = running.communicate()
                raise _failed(cell, f"did not end within {CELL_S:g} s", said + _text(progress)) from None
        if running.returncode:
            raise _failed(cell, f"ended with exit code {running.returncode}", said + _text(progress))
    print("\n".join(_some(said.rstrip().splitlines(), shown.first, shown.last)))


def _text(file: IO[str]) -> str:
    file.seek(0)
    return file.read()


def _some(lines: list[str], first: int | None, last: int | None) -> list[str]:
    """The first or last lines; an ellipsis stands for the others."""
    if first is not None and first < len(lines):
        return [*lines[:first], "..."]
    if last is not None and last < len(lines):
        return ["...", *lines[len(lines) - last :]]
    return lines


def _failed(command: str, how: str, said: str) -> CommandFailed:
    last = "\n".join(said.rstrip().splitlines()[-SAID:])
    return CommandFailed(f"\n{command.strip()}\n{how}; its last lines:\n{last}")


class Beside:
    """A command that runs beside the cells, as in another terminal; it ends with the tutorial at the latest.

    Attributes:
        said: File with what it prints.
    """

    def __init__(self, command: str, said: str) -> None:
        self._command, self.said = command, Path(said)
        with self.said.open("w") as file:
            self._process = subprocess.Popen(shlex.split(command), stdout=file, stderr=subprocess.STDOUT)
        atexit.register(self.end)

    def check(self) -> None:
        """Nothing while it runs.

        Raises:
            CommandFailed: It has ended.
        """
        if self._process.poll() is not None:
            raise self._error(f"ended with exit code {self._process.returncode}")

    def output(self, timeout_s: float) -> str:
        """What it printed, once it has ended by itself.

        Raises:
            CommandFailed: It failed, or did not end in that time.
        """
        try:
            code = self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.end()
            raise self._error(f"did not end within {timeout_s:g} s") from None
        if code:
            raise self._error(f"ended with exit code {code}")
        return self.said.read_text().strip()

    def end(self) -> None:
        """End it, first by a signal that it may handle."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(60.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _error(self, how: str) -> CommandFailed:
        return _failed(self._command, how, self.said.read_text())


@register_cell_magic
def writefile(name: str, cell: str) -> None:
    """Write a file, without a word."""
    Path(name).write_text(cell, encoding="utf-8")


def from_first_tutorial(*names: str) -> None:
    """Write files that the first tutorial writes, for a lesson that begins with them.

    Raises:
        LookupError: The first tutorial writes no such file.
    """
    written = dict(WRITTEN.findall(FIRST.read_text(encoding="utf-8")))
    for name in names:
        if name not in written:
            raise LookupError(f"{FIRST} writes no {name}; it writes {', '.join(written)}")
        writefile(name, written[name])


def picture(page: str, title: str) -> Image:
    """The picture of a page whose title begins with these words.

    Raises:
        LookupError: The page has no such picture; the message lists those that it has.
    """
    titles = []
    for data, alt in PICTURE.findall(Path(page).read_text(encoding="utf-8")):
        titles.append(html.unescape(alt))
        if titles[-1].startswith(title):
            return Image(base64.b64decode(data))
    raise LookupError(f"{page} has no picture {title!r}; it has {', '.join(titles)}")


def drawn(diagnosis: Diagnosis, title: str) -> Image:
    """The picture that the report of a diagnosis would have under this title."""
    from estimator.diagnosis.figures import pictures

    by_title = {each.title: each for each in pictures(diagnosis)}
    return Image(base64.b64decode(by_title[title].png_base64))
