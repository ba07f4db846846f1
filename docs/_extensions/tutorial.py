"""What the cells of tutorials use: a terminal, files, and the pictures that a reader sees in the pages that `coilcal` writes.

IPython's own `%%sh` hands on what a program prints in pieces, in the middle of lines, and standard error after standard output.
"""

from __future__ import annotations

import base64
import html
import re
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

from IPython.core.error import UsageError
from IPython.core.magic import register_cell_magic
from IPython.display import Image

if TYPE_CHECKING:
    from estimator import Diagnosis

PICTURE = re.compile(r'<img src="data:image/png;base64,([^"]+)" alt="([^"]*)">')


@register_cell_magic
def sh(_: str, cell: str) -> None:
    """Run commands as a terminal does, and print what they print; a command that fails stops the building of the site."""
    ran = subprocess.run(
        ["sh", "-ec", cell], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    print(ran.stdout.rstrip())
    if ran.returncode:
        raise UsageError(f"exit code {ran.returncode}")


@register_cell_magic
def writefile(name: str, cell: str) -> None:
    """Write a file, without a word."""
    Path(name).write_text(cell, encoding="utf-8")


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
