"""`coilcal docs`: the pages of the documentation, without the checkout and without a browser."""

from __future__ import annotations

import re
import sys
from importlib.metadata import files
from pathlib import Path

import click

from estimator.cli.options import flag, json_option
from estimator.cli.output import CoilcalCommand, show
from estimator.code_version import ROOT
from estimator.errors import InvalidInput, closest, quoted

FOLDERS, BESIDE = ("tutorials", "how-to", "explanation"), ("file-formats", "glossary")
SITE = "site/index.html"
# What only the build of the site understands: front matter, lists of pages, cells that it does not show, and the marks of others.
OF_SITE = (
    re.compile(r"\A---\n.*?\n---\n", re.DOTALL),
    re.compile(r"^```\{toctree\}\n.*?\n```$\n?", re.DOTALL | re.MULTILINE),
    re.compile(
        r"^```\{code-cell\} ipython3\n(?::|---\n)tags: \[remove-\w+\].*?\n```$\n?", re.DOTALL | re.MULTILINE
    ),
    re.compile(r"(?<=^```)\{code-cell\} ipython3$|^%%\w+.*\n", re.MULTILINE),
)


@click.command("docs", cls=CoilcalCommand, takes_derivatives=False)
@click.argument("page", required=False)
@flag("--open is_opened", "Open the site in a browser, where it is there: 'make docs' builds it.")
@json_option
def docs_command(page: str | None, is_opened: bool, as_json: bool) -> None:
    """Show a PAGE of the documentation, such as import-your-data; without PAGE, list all.

    `coilcal COMMAND --help` has the options of a command, `coilcal explain CAUSE` a cause.
    """
    root = _folder()
    paths = [
        path for folder in FOLDERS for path in sorted((root / folder).glob("*.md")) if path.stem != "index"
    ]
    pages = {path.stem: path for path in (*paths, *(root / f"{name}.md" for name in BESIDE))}
    site = path if (path := root.parent / SITE).is_file() else None
    if is_opened:
        _open(site)
    elif page is None:
        titles = {name: _title(path) for name, path in pages.items()}
        longest = max(map(len, titles), default=0)
        lines = [f"{name:{longest}}  {title}" for name, title in titles.items()]
        lines.append(
            f"site for a browser: {site}"
            if site
            else "'make docs' in the checkout builds a site for a browser"
        )
        show({"pages": titles, "site": site and str(site)}, "\n".join(lines), as_json)
    else:
        name = page.removesuffix(".md").rpartition("/")[2]
        if name not in pages:
            hint = closest(name, pages)
            raise InvalidInput(f"page must be one that 'coilcal docs' lists; received {quoted(page)}{hint}")
        text = _page(pages[name])
        show({"page": name, "text": text}, text, as_json) if as_json or not sys.stdout.isatty() else _print(
            text
        )


def _folder() -> Path:
    """Folder of the pages: in the checkout, or among the files that an installed release has brought."""
    if (ROOT / "pyproject.toml").is_file():
        return ROOT / "docs"
    for file in files("coilcal") or ():
        if file.match("share/coilcal/docs/glossary.md"):
            return Path(str(file.locate())).resolve().parent
    raise InvalidInput("pages must have been installed with coilcal; its record of files has none")


def _title(path: Path) -> str:
    lines = path.read_text(encoding="utf-8").splitlines()
    return next((line[2:] for line in lines if line.startswith("# ")), path.stem)


def _page(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    for of_site in OF_SITE:
        text = of_site.sub("", text)
    return text.strip()


def _open(site: Path | None) -> None:
    if site is None:
        raise InvalidInput("a site must be there to be opened; 'make docs' in the checkout builds it")
    click.launch(str(site))


def _print(text: str) -> None:
    """A page laid out for a terminal, with its pager."""
    from rich.console import Console
    from rich.markdown import Markdown

    console = Console()
    with console.capture() as laid_out:
        console.print(Markdown(text))
    click.echo_via_pager(laid_out.get())
