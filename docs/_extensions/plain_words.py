"""Help texts and docstrings as reStructuredText: an asterisk in a help text is one, and `Returns: what` may stand on one line."""

from __future__ import annotations

import re
from typing import Any

import click
from sphinx.application import Sphinx

ASTERISK = re.compile(r"(?<![*\\])\*(?!\*)")
ONE_LINE = re.compile(r"(\s*)(Returns|Raises|References): (\S.*)")
TITLES = ("Returns:", "Raises:", "References:", "Examples:")


def setup(app: Sphinx) -> dict[str, Any]:
    """Change the words before sphinx-click and napoleon read them."""
    app.connect("sphinx-click-process-options", _without_markup)
    app.connect("sphinx-click-process-description", _without_markup)
    app.connect("autodoc-process-docstring", _sections, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _without_markup(_app: Sphinx, _context: click.Context, lines: list[str]) -> None:
    lines[:] = [line if line.lstrip().startswith("..") else ASTERISK.sub(r"\\*", line) for line in lines]


def _sections(
    _app: Sphinx, _what: str, _name: str, _thing: object, _options: object, lines: list[str]
) -> None:
    """Each title on a line of its own, after an empty one."""
    shown: list[str] = []
    for line in lines:
        match = ONE_LINE.fullmatch(line)
        if match is not None:
            indent, title, words = match.groups()
            if title == "Returns":  # a colon would make what stands before it a type
                words = re.sub(r"(\w): ", r"\1 - ", words, count=1)
            shown += ["", f"{indent}{title}:", f"{indent}    {words}"]
        else:
            shown += ["", line] if line.strip() in TITLES else [line]
    lines[:] = shown
