"""Pictures of reports, for tutorials: what a reader sees in a page that `coilcal` writes is what the site shows."""

from __future__ import annotations

import base64
import html
import re
from pathlib import Path
from typing import TYPE_CHECKING

from IPython.display import Image

if TYPE_CHECKING:
    from estimator import Diagnosis

PICTURE = re.compile(r'<img src="data:image/png;base64,([^"]+)" alt="([^"]*)">')


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
