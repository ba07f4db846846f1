"""`coilcal docs`: pages in a terminal, from the checkout and from a wheel that has no checkout beside it."""

from __future__ import annotations

import json
import tomllib
from importlib.metadata import PackagePath

from estimator.cli import docs
from estimator.code_version import ROOT
from tests.estimator.cli.conftest import run


def test_every_page_that_is_listed_can_be_read():
    pages = json.loads(run("docs", "--json").stdout)["pages"]
    assert {"first-calibration", "import-your-data", "uncertainty", "glossary"} <= set(pages)
    for name, title in pages.items():
        page = run("docs", f"how-to/{name}.md").stdout
        assert page.startswith(f"# {title}\n")
        assert not any(mark in page for mark in ("{toctree}", "{code-cell}", "remove-cell", "%%sh"))
    unknown = run("docs", "import-your-dta")
    assert (unknown.exit_code, unknown.stdout) == (2, "")
    assert "the closest is import-your-data" in unknown.stderr


def test_a_wheel_brings_the_pages(monkeypatch, tmp_path):
    """Files lie where pyproject.toml puts them, as `pip` does it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    shared = project["tool"]["hatch"]["build"]["targets"]["wheel"]["shared-data"]
    installed = []
    for source, target in shared.items():
        (tmp_path / target).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / target).symlink_to(ROOT / source)
        installed.append(PackagePath(target))
        installed[-1].dist = type("Installed", (), {"locate_file": staticmethod(tmp_path.joinpath)})()
    pages = run("docs", "--json").stdout
    monkeypatch.setattr(docs, "ROOT", tmp_path)
    monkeypatch.setattr(docs, "files", lambda name: installed)
    monkeypatch.setattr(docs, "SITE", "not-built/index.html")
    assert json.loads(run("docs", "--json").stdout)["pages"] == json.loads(pages)["pages"]
    assert "a site must be there" in run("docs", "--open").stderr
    monkeypatch.setattr(docs, "files", lambda name: None)
    assert "pages must have been installed" in run("docs").stderr
