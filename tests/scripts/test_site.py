"""A site that cannot be built says which command of which tutorial failed, and leaves the site from before."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest

from tests.program import PYTHON, finished

ROOT = Path(__file__).parents[2]
SETTINGS = """
import sys
sys.path.insert(0, {extensions!r})
extensions = ["myst_nb", "terminal_cells"]
source_suffix = {{".md": "myst-nb"}}
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
"""
TUTORIAL = """---
file_format: mystnb
kernelspec: {{name: python3}}
---

# A lesson

```{{code-cell}} ipython3
:tags: [remove-cell]
import sys
sys.path.insert(0, {extensions!r})
import tutorial
other = tutorial.Beside("sleep 1000.25", "other.txt")
```

```{{code-cell}} ipython3
{cell}
```
"""
GOOD = "%%sh --last 1\necho one\necho two"


def built(folder: Path, cell: str) -> tuple[int, str, str]:
    """Exit code, what was printed, and the page of the site, of a build with one tutorial that has this cell."""
    extensions = str(ROOT / "docs" / "_extensions")
    docs = folder / "docs"
    docs.mkdir(exist_ok=True)
    (docs / "conf.py").write_text(SETTINGS.format(extensions=extensions), encoding="utf-8")
    (docs / "index.md").write_text(TUTORIAL.format(extensions=extensions, cell=cell), encoding="utf-8")
    command = [PYTHON, "-m", "scripts.documentation.site", docs, folder / "site"]
    together = {"capture_output": False, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    ran = finished(*command, timeout=120, **together)
    return ran.returncode, ran.stdout, (folder / "site" / "index.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module", autouse=True)
def has_sphinx() -> None:
    pytest.importorskip("myst_nb", reason="needs the extra `docs`, which `make docs` installs")


@pytest.mark.parametrize(
    "cell",
    [
        "%%sh\necho what it said\n(echo no arm; exit 3) | tail -1",
        "%%sh --last 1\necho what it said\nfalse\necho after",
        "%%sh --results\necho what it said\n(echo no arm >&2; exit 3)",
        'import tutorial\ntutorial.Beside("sh -c \'echo what it said; exit 3\'", "said.txt").output(60)',
    ],
    ids=["in a pipe", "not the last", "standard error set aside", "beside the cells"],
)
def test_a_command_that_fails_ends_the_build_at_once(cell, tmp_path):
    began = time.monotonic()
    code, said, page = built(tmp_path, cell)
    assert code == 1
    assert time.monotonic() - began < 60.0
    for text in (said.partition("The site was not built")[2], page):
        assert "docs/index.md failed" in text
        assert "what it said" in text
        assert "exit code 3" in text or "exit code 1" in text
        assert "CommandFailed" in text
    assert "has a page that says so" in said
    assert not is_running("sleep 1000.25")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["docs", "site"], "left of the work"


def test_the_site_from_before_is_left_when_a_build_fails(tmp_path):
    code, said, before = built(tmp_path, GOOD)
    assert code == 0, said
    assert "two" in before
    assert "one" not in before.partition("echo two")[2], "only the last line was asked for"
    code, said, after = built(tmp_path, "%%sh\nfalse | cat")
    assert code == 1
    assert "is left as it was before" in said
    assert after == before


def test_a_warning_of_sphinx_fails_the_build(tmp_path):
    code, said, _ = built(tmp_path, f"{GOOD}\n```\n\n[nowhere](missing.md)\n\n```{{code-cell}} ipython3\n1")
    assert code == 1
    assert "Sphinx warned" in said


def is_running(command: str) -> bool:
    ran = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True, check=True)
    return command in ran.stdout.splitlines()
