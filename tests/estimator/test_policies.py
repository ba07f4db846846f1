"""Rules with numbers stand in one policy each: all of them say why, all of them are read."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import estimator

PACKAGE = Path(estimator.__file__).parent


def rules(policy: str) -> dict[str, str]:
    """Name of each constant and the text below it."""
    body = ast.parse((PACKAGE / policy / "policy.py").read_text(encoding="utf-8")).body
    found = {}
    for statement, below in zip(body, [*body[1:], None], strict=True):
        if isinstance(statement, ast.Assign):
            text = below.value if isinstance(below, ast.Expr) else None
            is_text = isinstance(text, ast.Constant) and isinstance(text.value, str)
            for name in ast.walk(statement.targets[0]):
                if isinstance(name, ast.Name):
                    found[name.id] = text.value if is_text else ""
    return found


@pytest.mark.parametrize("policy", ["diagnosis", "recalibration"])
def test_every_rule_says_what_it_decides_and_how_much_it_matters(policy):
    for name, text in rules(policy).items():
        assert "Study" in text, name


@pytest.mark.parametrize("policy", ["diagnosis", "recalibration"])
def test_every_rule_is_read_somewhere(policy):
    code = "".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    for name in rules(policy):
        assert f"policy.{name}" in code, name
