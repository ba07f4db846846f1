"""Code in the documentation: Python blocks run, commands are commands with such options, rig files and plans are read."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from sybil import Document, Sybil
from sybil.parsers.markdown import PythonCodeBlockParser, SkipParser

from estimator.calibration.calibrate import calibrate
from estimator.cli.main import main
from estimator.errors import InvalidInput
from estimator.readings.plan import load_plan
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from estimator.yaml_section import Section
from tests.test_docs import CAUSE_PAGES, PAGES, ROOT

BLOCK = re.compile(r"^( *)```+(\{code-cell\} ipython3|[\w-]*)[^\n]*\n(.*?)^\1```", re.DOTALL | re.MULTILINE)
OPTIONS_OF_A_CELL = re.compile(r"\A(---\n.*?^---\n|(?::[^\n]*\n)+)", re.DOTALL | re.MULTILINE)
PIPES = {"|", ">", ">>", "2>&1", "&&", "&", ";"}

# Blocks of these need a service that runs; tests/estimator/service makes the same calls.
NEED_A_SERVICE = {ROOT / "docs/how-to/run-the-service.md"}
FIRST_TUTORIAL = ROOT / "docs/tutorials/first-calibration.md"  # whose rig the plans of other pages are for


def blocks(page: Path) -> Iterator[tuple[str, str]]:
    """Language and text of each block; a cell of a tutorial without its options, `%%writefile rig.yaml` as the language of a file."""
    for _, language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        shown = OPTIONS_OF_A_CELL.sub("", text) if "code-cell" in language else text
        magic, _, rest = shown.partition("\n")
        yield (magic, rest) if magic.startswith("%%") else (language, shown)


def commands(page: Path) -> Iterator[list[str]]:
    """Calls of coilcal in terminals and cells, as lists of words."""
    for language, text in blocks(page):
        if language not in ("console", "sh", "bash", "") and not language.startswith("%%sh"):
            continue
        for line in text.replace("\\\n", " ").splitlines():
            words = shlex.split(line.removeprefix("$ "), comments=True) if "coilcal " in line else []
            if "coilcal" in words:
                call = words[words.index("coilcal") + 1 :]
                end = next(
                    (i for i, word in enumerate(call) if word in PIPES or word.startswith(("<<", "2>"))),
                    len(call),
                )
                yield call[:end]


def test_commands_exist_with_their_options():
    for page in PAGES:
        for words in commands(page):
            command, arguments = command_of(words, page)
            known = {option for p in command.params for option in (*p.opts, *p.secondary_opts)} | {
                "--help",
                "-h",
            }
            options = [word.partition("=")[0] for word in arguments if re.match(r"-+[a-z]", word)]
            assert not set(options) - known, f"{command.name} in {page}"


def command_of(words: list[str], page: Path) -> tuple[click.Command, list[str]]:
    """The command that a call names, and its arguments."""
    command: click.Command = main
    if words[:2] == ["--via", "local"]:
        words = words[2:]
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"coilcal {' '.join(words)} in {page}"
        command, words = command.commands[words[0]], words[1:]
    return command, words


def rigs_and_plans(page: Path) -> tuple[list[Rig], list[str]]:
    """Rigs that a page describes, and the texts of its plans."""
    rigs, plans = [], []
    for language, text in blocks(page):
        if not (language == "yaml" or language.endswith(".yaml")) or "schema_version" not in text:
            continue
        if "poses" in Section.from_text(text, str(page)):
            plans.append(text)
        else:
            rigs.append(rig_from_text(text, str(page)))
    return rigs, plans


def test_rig_files_and_plans_are_read(tmp_path):
    for page in PAGES:
        rigs, plans = rigs_and_plans(page)
        rigs = rigs or rigs_and_plans(FIRST_TUTORIAL)[0]
        for number, text in enumerate(plans):
            path = tmp_path / f"plan{number}.yaml"
            path.write_text(text, encoding="utf-8")
            assert any(_is_plan_of(path, rig) for rig in rigs), f"a plan for no rig of {page}: {text}"


def _is_plan_of(path: Path, rig: Rig) -> bool:
    try:
        load_plan(path, rig)
    except InvalidInput:
        return False
    return True


def test_cells_of_tutorials_are_python():
    """The building of the site runs them."""
    for page in PAGES:
        for language, text in blocks(page):
            if language in ("{code-cell} ipython3", "%%writefile lab_causes.py"):
                compile(text, str(page), "exec")


def test_cells_of_tutorials_hide_no_error():
    """Lines are chosen by options of `%%sh`: an error in a file is not quoted, and `head` may end what writes to it."""
    for page in PAGES:
        for language, text in blocks(page):
            if language.startswith("%%sh"):
                assert not re.search(r"2>|\|\s*(head|tail|true)\b", text), f"{text} in {page}"


def documents() -> list[Path]:
    return [
        page
        for page in PAGES
        if page not in NEED_A_SERVICE and "```python" in page.read_text(encoding="utf-8")
    ]


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the blocks of the documentation begin with: rig.yaml, session.zarr, calibration."""
    from estimator.model.simulate import simulate
    from tests.estimator.conftest import PLAN, RIG, SETTINGS, TRUTH

    folder = tmp_path_factory.mktemp("reader")
    (folder / "rig.yaml").write_text(RIG, encoding="utf-8")
    (folder / "plan.yaml").write_text(PLAN, encoding="utf-8")
    rig = rig_from_text(RIG)
    session = Session(
        rig, simulate(rig, load_plan(folder / "plan.yaml", rig), TRUTH, seed=1), "simulated", truth=TRUTH
    )
    session.save(folder / "session.zarr")
    calibrate(session, settings=SETTINGS, seed=1, out=folder / "calibration")
    return folder


@pytest.mark.whole
@pytest.mark.parametrize("page", documents(), ids=lambda page: str(page.relative_to(ROOT)))
def test_python_blocks_run(page, calibrated, monkeypatch):
    """All in the order of the page, those after `<!--- skip: next -->` left out."""
    monkeypatch.chdir(calibrated)
    document: Document = Sybil(parsers=[PythonCodeBlockParser(), SkipParser()]).parse(page)
    for example in document.examples():
        example.evaluate()


def test_generated_pages_are_those_of_the_library():
    from scripts.documentation.causes import library

    assert {path.stem for path in CAUSE_PAGES} == {*library(), "index", "corrections"}
