"""Navigation and pictures of the documentation site; building it is `make docs`."""

from __future__ import annotations

import re
from pathlib import Path

from scripts.documentation.offline import loaded_from_elsewhere
from tests.test_docs import CAUSE_PAGES, PAGES, ROOT

DOCS = ROOT / "docs"
GENERATED = DOCS / "reference" / "causes"
TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```", re.DOTALL | re.MULTILINE)
PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
CELL = re.compile(r"^```\{code-cell\} ipython3\n(.*?)^```", re.DOTALL | re.MULTILINE)
DRAWS = re.compile(r"\bpicture\(|\bdrawn\(|plt\.show\(")


def entries(page: Path) -> list[Path]:
    """Pages that the tables of contents of a page name."""
    named: list[Path] = []
    for text in TOCTREE.findall(page.read_text(encoding="utf-8")):
        is_glob = ":glob:" in text
        for line in filter(None, (line.strip() for line in text.splitlines())):
            if line.startswith(":"):
                continue
            target = (page.parent / f"{line}.md").resolve()
            named += sorted(target.parent.glob(target.name)) if is_glob else [target]
    return named


def on_the_site() -> list[Path]:
    return [page for page in PAGES if DOCS in page.parents]


def test_every_page_is_reached_from_the_first_one_and_once():
    reached, to_do = [DOCS / "index.md"], [DOCS / "index.md"]
    while to_do:
        for page in entries(to_do.pop()):
            assert page.exists() or page in CAUSE_PAGES, page
            reached.append(page)
            if page.exists():
                to_do.append(page)
    assert len(reached) == len(set(reached)), "a page stands in two tables of contents"
    written = {page for page in reached if page.parent != GENERATED}  # which are there after `make docs`
    assert written == set(on_the_site())


def test_pictures_are_there_and_say_what_they_show():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for words, path in PICTURE.findall(text):
            assert (page.parent / path).exists(), f"{path} in {page}"
            assert len(words.split()) >= 3, f"{path} in {page} needs a text for those who cannot see it"
        for cell in CELL.findall(text):
            assert not DRAWS.search(cell) or re.search(r"^    alt: \w+,? \w+,? \w+", cell, re.MULTILINE), (
                f"{cell} in {page}"
            )


def test_the_site_loads_nothing_from_elsewhere():
    """Settings and styles of our own; `make docs` checks the pages that were built."""
    for file in (DOCS / "conf.py", *(DOCS / "_static").iterdir(), *(DOCS / "_extensions").glob("*.py")):
        assert not re.search(r"https?://", file.read_text(encoding="utf-8")), file


def test_what_is_loaded_from_elsewhere_is_found(tmp_path):
    (tmp_path / "index.html").write_text(
        '<a href="https://example.org">a link loads nothing</a><img src="figure.png"><script src="https://cdn.example/a.js">',
        encoding="utf-8",
    )
    (tmp_path / "site.css").write_text(
        '@import "//fonts.example/a.css"; b {background: url(b.png)}', encoding="utf-8"
    )
    assert loaded_from_elsewhere(tmp_path) == [
        "index.html: https://cdn.example/a.js",
        "site.css: //fonts.example/a.css",
    ]


def test_tutorials_show_pictures_that_reports_have():
    """By their titles, up to a number or a name that the report fills in."""
    figures = [file.read_text(encoding="utf-8") for file in (ROOT / "estimator").glob("*/figures.py")]
    titles = [title.split("{")[0] for text in figures for title in re.findall(r'"([A-Z][^"\n]{3,})"', text)]
    for page in (DOCS / "tutorials").glob("*.md"):
        for wanted in re.findall(r'(?:picture|drawn)\([^)]*"([^"]+)"\)', page.read_text(encoding="utf-8")):
            assert any(title.startswith(wanted) or wanted.startswith(title) for title in titles), (
                f"{wanted} in {page}"
            )
