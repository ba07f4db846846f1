"""Words in the code: docstrings that stand by themselves, and local variables that say what they hold (CONTRIBUTING.md)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FRAGMENT = re.compile(
    r"(?:Of|By|That|Those|Where|As|The former|The same)\b"
)  # of a sentence that stands elsewhere
SAY_NOTHING = {"found", "one", "kept"}


def sources() -> Iterator[tuple[str, str]]:
    """Path and text of every file that is held to these words."""
    for package in ("coilcal", "estimator", "drivers"):
        for file in sorted((ROOT / package).rglob("*.py")):
            yield file.relative_to(ROOT).as_posix(), file.read_text(encoding="utf-8")


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of what documents a module, a class, a function, or the name assigned above it."""
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", None)
        for statement in body if isinstance(body, list) else []:
            value = statement.value if isinstance(statement, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield value.lineno, value.value.strip()


def local_variables(source: str) -> Iterator[tuple[int, str]]:
    """Line and name of every variable that is assigned, by a loop or a comprehension too; not the fields of a class."""
    tree = ast.parse(source)
    fields = {
        id(target)
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for statement in node.body
        if isinstance(statement, ast.Assign | ast.AnnAssign)
        for target in (statement.targets if isinstance(statement, ast.Assign) else [statement.target])
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and id(node) not in fields:
            yield node.lineno, node.id


def test_no_docstring_opens_with_a_fragment():
    fragments = [
        f"{name}:{line}: {text}"
        for name, source in sources()
        for line, text in docstrings(source)
        if FRAGMENT.match(text)
    ]
    assert not fragments, "\n".join(fragments)


def test_local_variables_say_what_they_hold():
    empty = [
        f"{name}:{line}: {variable}"
        for name, source in sources()
        for line, variable in local_variables(source)
        if variable in SAY_NOTHING
    ]
    assert not empty, "\n".join(empty)


def test_fragments_and_empty_names_are_seen():
    source = '"""As above."""\nLIMIT = 1\n"""The same for two."""\nclass A:\n    kept: int\n    """Where it lies."""\n'
    assert all(FRAGMENT.match(text) for _, text in docstrings(source))
    assert len(list(docstrings(source))) == 3
    assert not SAY_NOTHING & {name for _, name in local_variables(source)}
    source = "for one in [found for found in a]:\n    if (kept := one):\n        pass\n"
    assert {name for _, name in local_variables(source)} == SAY_NOTHING
    assert FRAGMENT.match("Offset of a sensor, in T.") is None
