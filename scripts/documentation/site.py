"""Builds the site beside the one that is there, which it replaces only when everything succeeded; `make docs` runs it.

A tutorial whose command fails ends the build at once, with the tutorial, the command and its last lines. What stands in the folder then is
the site from before, or, where there was none, a page that says what failed.
"""

from __future__ import annotations

import argparse
import html
import io
import sys
import tempfile
import time
from pathlib import Path

from scripts.documentation.offline import loaded_from_elsewhere

PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>coilcal: not built</title></head>
<body><h1>The documentation was not built</h1><p>{date}</p><pre>{why}</pre></body></html>
"""


class NotBuilt(Exception):
    """The site was not built; the message says which page failed, and how."""


def build(docs: Path, site: Path) -> None:
    """The site of a folder of pages, every tutorial run anew.

    Raises:
        NotBuilt: A tutorial failed, Sphinx warned, or a page loads something from another computer.
    """
    site.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{site.name}.", dir=site.parent) as work:
        made = Path(work) / "made"
        try:
            _make(docs, made, Path(work) / "doctrees")
        except NotBuilt as error:
            _say(site, str(error))
            raise
        if site.exists():
            site.rename(Path(work) / "before")
        made.rename(site)


def _make(docs: Path, made: Path, doctrees: Path) -> None:
    from myst_nb.core.execute.base import ExecutionError  # the extra `docs`, which no test needs
    from sphinx.application import Sphinx
    from sphinx.util.console import color_terminal, nocolor
    from sphinx.util.docutils import docutils_namespace, patch_docutils

    if not color_terminal():
        nocolor()
    warned = io.StringIO()
    try:
        with patch_docutils(docs), docutils_namespace():
            sphinx = Sphinx(
                docs, docs, made, doctrees, "html", warning=warned, freshenv=True, warningiserror=True
            )
            sphinx.build(force_all=True)
    except ExecutionError as error:
        raise NotBuilt(f"{error} failed: {error.__cause__}") from error
    if sphinx.statuscode:
        raise NotBuilt(f"Sphinx warned:\n{warned.getvalue()}")
    if elsewhere := loaded_from_elsewhere(made):
        raise NotBuilt("\n".join(["pages load from another computer:", *elsewhere]))


def _say(site: Path, why: str) -> None:
    """A page that says what failed, where there is no site; one from before is left as it is."""
    if not (site / "index.html").exists():
        site.mkdir(exist_ok=True)
        page = PAGE.format(date=time.strftime("%Y-%m-%d %H:%M"), why=html.escape(why))
        (site / "index.html").write_text(page, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("docs", type=Path)
    parser.add_argument("site", type=Path)
    options = parser.parse_args()
    is_there = (options.site / "index.html").exists()
    try:
        build(options.docs.resolve(), options.site.resolve())
    except NotBuilt as error:
        left = "is left as it was before" if is_there else "has a page that says so"
        sys.exit(f"\nThe site was not built; {options.site} {left}.\n{error}")


if __name__ == "__main__":
    main()
