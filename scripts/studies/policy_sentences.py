"""Write what the study of the policies found behind each rule, and its table into docs/studies; `make policy` runs it after the study."""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import textwrap
from pathlib import Path
from types import ModuleType

from scripts.studies.policy import (
    Row,
    changes,
    constants,
    diagnosis_policy,
    other_values,
    read,
    recalibration_policy,
    show,
)

WIDTH = 140
TABLE = Path(__file__).resolve().parents[2] / "docs/studies/policy.txt"
NOT_STUDIED = "not in it"  # rules that no diagnosis and no judgement reads, such as limits of time


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=Path, default=Path("out/policy.jsonl"))
    rows = read(parser.parse_args().rows)
    for policy in (diagnosis_policy, recalibration_policy):
        path = Path(str(policy.__file__))
        path.write_text(rewritten(path.read_text(encoding="utf-8"), policy, rows), encoding="utf-8")
    table = io.StringIO()
    with contextlib.redirect_stdout(table):
        show(rows)
    tried = (
        line
        for line in table.getvalue().splitlines(keepends=True)
        if "| none |" not in line and not line.endswith("| nothing |\n")
    )
    TABLE.write_text("".join(tried).lstrip(), encoding="utf-8")


def rewritten(text: str, policy: ModuleType, rows: list[Row]) -> str:
    """The text of a policy with the study's sentence at the end of each docstring."""
    for name in constants(policy):
        match = re.search(rf'^{name}\b[^"]*?= .*?"""(.*?)"""', text, flags=re.DOTALL | re.MULTILINE)
        if match is None:
            continue
        words = " ".join(match[1].split())
        reason, _, said = words.partition(" Study")
        if NOT_STUDIED in said:
            continue
        paragraph = textwrap.fill(f'"""{reason} {sentence(name, policy, rows)}"""', WIDTH)
        text = text[: match.start(1) - 3] + paragraph + text[match.end(1) + 3 :]
    return text


def sentence(name: str, policy: ModuleType, rows: list[Row]) -> str:
    """How much a rule matters, over both other values."""
    base = {row["case"]: row for row in rows if not row["rule"]}
    cases: dict[str, list[str]] = {}
    for row in rows:
        if row["rule"] == name and row["which"] < len(other_values(name, vars(policy)[name])):
            cases.setdefault(row["case"], []).extend(changes(base[row["case"]], row))
    if not cases:
        return "Study: read by no case."
    n_said = sum("verdict" in words or "names" in words or "fails" in words for words in cases.values())
    n_other = sum(bool(words) for words in cases.values()) - n_said
    said = [f"verdict or names change in {n_said}"] if n_said else []
    said += [f"numbers change in {n_other}"] if n_other else []
    return f"Study of {len(cases)} case{'s' if len(cases) > 1 else ''}: {', '.join(said) or 'no change'}."


if __name__ == "__main__":
    main()
