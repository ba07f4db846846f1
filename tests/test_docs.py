"""The documentation names what is there: files, anchors, modules, causes, commands, keys."""

from __future__ import annotations

import re
from dataclasses import fields
from functools import cache
from pathlib import Path

import click

from estimator.cli.main import main
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent
from estimator.export.formats import FORMATS
from estimator.readings.metrics import ErrorMetrics
from estimator.service.settings import KEYS, Settings
from tests.documented import CAUSES, COMMANDS, SERVICE, SUMMARY, keys, section

ROOT = Path(__file__).parents[1]
CAUSE_FOLDER = ROOT / "docs/reference/causes"  # `make docs` writes its pages
MADE = ("docs/reference/causes", "docs/reference/rig-keys")  # by `make docs`, and not kept
PAGES = sorted(
    page
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"))
    if CAUSE_FOLDER not in page.parents
)
CAUSE_PAGES = {
    CAUSE_FOLDER / f"{name}.md"
    for name in (
        "index",
        "corrections",
        *(
            n
            for n, e in EFFECTS.items()
            if not e.is_correction and type(e).__module__.startswith("estimator.")
        ),
    )
}
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
LINK = re.compile(r"\[[^\]]*\]\(<?([^)>\s]+)>?\)")
MODULE_FILE = re.compile(r"(?<![\w/.])(?:estimator|drivers|scripts|tests|configs)/[\w/.-]*\w")
MODULE = re.compile(r"(?<![\w/.-])(?:estimator|drivers|scripts)(?:\.[a-z_]\w*)+")
TERM = re.compile(r"^- \*\*(.+?)\*\*: ", re.MULTILINE)


@cache
def anchors(page: Path) -> set[str]:
    """As GitHub makes them of headings: small letters, no punctuation, hyphens for spaces."""
    text = re.sub(
        r"^( *)(```+).*?^\1\2", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.strip().lower()).replace(" ", "-") for title in titles}


def is_module(name: str) -> bool:
    """Whether a dotted name is a package, a module, or a name that a module or package has."""
    parts = name.split(".")
    for n in range(len(parts), 0, -1):
        base = ROOT.joinpath(*parts[:n])
        file = base.with_suffix(".py") if base.with_suffix(".py").is_file() else base / "__init__.py"
        if file.is_file():
            rest = parts[n:]
            return not rest or re.search(rf"\b{rest[0]}\b", file.read_text(encoding="utf-8")) is not None
        if base.is_dir() and n == len(parts):
            return True
    return False


def test_links_lead_to_files_and_headings():
    for page in PAGES:
        for target in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
            if re.match(r"[a-z]+:", target):
                continue
            path, _, anchor = target.partition("#")
            file = (page.parent / path).resolve() if path else page
            assert file.exists() or file in CAUSE_PAGES, f"{target} in {page}"
            assert not anchor or anchor in anchors(file), f"{target} in {page}"


def test_paths_and_modules_exist():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for path in MODULE_FILE.findall(text):
            assert "NAME" in path or (ROOT / path).exists(), f"{path} in {page}"
        for name in MODULE.findall(text):
            assert "NAME" in name or is_module(name), f"{name} in {page}"


def test_what_is_cited_is_in_the_repository():
    """Pages by their path, decisions by path and number; other documents in capitals only where they are there."""
    for folder in ("coilcal", "estimator", "drivers", "scripts", "tests", "configs", "docs", "."):
        files = ROOT.glob("*.md") if folder == "." else (ROOT / folder).rglob("*")
        for file in sorted(file for file in files if file.suffix in (".py", ".md", ".yaml")):
            text = file.read_text(encoding="utf-8")
            for path in re.findall(r"(?<![\w/.])docs/[\w/-]++(?:\.md)?(?!\[)", text):
                is_made = path in MADE
                assert is_made or any(ROOT.glob(f"{path}*")), f"{path} in {file}"
            for name in re.findall(r"\b[A-Z][A-Z_]{3,}\.md\b", text):
                assert (ROOT / name).is_file(), f"{name} in {file}"


def test_every_cause_is_listed_with_its_quantities():
    """Rig files and scripts rely on these names: a row is added for a new cause, and none goes."""
    rows = re.findall(r"^\|`(\w+)`\|[\w ]+\|(.*?)\|", section(CAUSES), re.MULTILINE)
    library = [n for n, effect in EFFECTS.items() if type(effect).__module__.startswith("estimator.effects.")]
    unlike = {name for name, _ in rows}.symmetric_difference(library)
    assert not unlike, (
        f"the table 'Names of causes' in docs/file-formats.md has one row for each cause; look at {unlike}"
    )
    assert len(rows) == len(library)
    for name, cell in rows:
        listed = re.findall(r"`(\w+)`", cell)
        quantities = [quantity.key for quantity in EFFECTS[name].quantities(Extent())]
        assert listed == quantities or (set(listed) < set(quantities) and "and so on" in cell), name


def test_every_format_of_an_export_is_listed():
    page = (ROOT / "docs/how-to/use-a-calibration-elsewhere.md").read_text(encoding="utf-8")
    first_column = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", page.split("\n## ")[0], re.MULTILINE)
    assert sorted(re.findall(r"\w+", " ".join(first_column))) == sorted(FORMATS)


def test_every_command_is_listed():
    context = click.Context(main)
    names = []
    for name, command in main.commands.items():
        subcommands = command.list_commands(context) if isinstance(command, click.Group) else [""]
        if isinstance(command, click.Group) and command.invoke_without_command:
            subcommands = ["", *subcommands]
        names += [f"coilcal {name} {subcommand}".strip() for subcommand in subcommands]
    assert sorted(key for key in keys(COMMANDS) if key.startswith("coilcal")) == sorted(names)


def test_every_setting_of_the_service_is_listed_with_its_default():
    rows = re.findall(r"^\| (`.+?`) \| ([^|]+) \|", section(SERVICE), re.MULTILINE)
    listed: dict[str, str] = {}
    for names, values in rows:
        words = re.findall(r"`(\w+)`", names)
        listed |= dict(
            zip(words, (values.replace("`", "").split(", ") * len(words))[: len(words)], strict=True)
        )
    shown = {Path("coilcal-data"): "coilcal-data", "": "none", (): "none"}
    defaults = {key: getattr(Settings(), key) for key in KEYS}
    defaults |= {key: str(value).lower() for key, value in defaults.items() if isinstance(value, bool)}
    assert listed == {
        key: shown.get(v, f"{v:g}" if isinstance(v, float) else str(v)) for key, v in defaults.items()
    }


def test_error_keys_are_those_of_the_metrics():
    text = section(SUMMARY).split("**Error keys.**")[1].split("\n\n")[0]
    assert [key for key in re.findall(r"`(\w+)`", text) if key != "vector_T"] == [
        field.name for field in fields(ErrorMetrics) if field.name != "vector_T"
    ]


def test_glossary_explains_each_term_once_in_alphabetical_order():
    terms = [
        term.casefold() for term in TERM.findall((ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"))
    ]
    assert terms == sorted(set(terms))
