"""Write docs/results.md and docs/performance.md from the rows in docs/studies; `make results` runs it, and a test compares."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import yaml

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = ("results", "performance")
SHARED = ("command", "machine", "date", "commit")  # a section may state these for all its rows


def page(data: dict[str, Any]) -> str:
    """Markdown of one page: its introduction, then text, table and figures of each section."""
    blocks = [f"# {data['title']}", data["text"]]
    for section in data["sections"]:
        blocks += [f"## {section['title']}", *filter(None, [section.get("text")])]
        rows = section.get("rows", [])
        shared = {key: section[key] for key in SHARED if key in section}
        shared |= {key: rows[0][key] for key in SHARED if is_alike(key, rows)}
        rows = [{k: v for k, v in row.items() if shared.get(k) != v} for row in rows]
        blocks += [said_once(data["columns"], shared, rows)]
        blocks += [table(data["columns"], rows)] if rows else []
        blocks += [f"![{figure['alt']}](figures/{figure['file']})" for figure in section.get("figures", [])]
    return "\n\n".join(block.strip() for block in blocks if block) + "\n"


def is_alike(key: str, rows: list[dict[str, Any]]) -> bool:
    """Whether all rows state the same, which then stands once above the table."""
    return len(rows) > 1 and key in rows[0] and all(row.get(key) == rows[0][key] for row in rows)


def said_once(columns: dict[str, str], shared: dict[str, Any], rows: list[dict[str, Any]]) -> str:
    """What rows share, above their table; a row that differs says so in its own column."""
    words = ", ".join(f"{columns[key]}: {cell(key, value)}" for key, value in shared.items())
    differ = any(key in row for row in rows for key in shared)
    return words + ("; rows that differ say so" if words and differ else "")


def table(columns: dict[str, str], rows: list[dict[str, Any]]) -> str:
    """One line a row; a column that no row fills is left out."""
    unknown = {key for row in rows for key in row} - set(columns)
    if unknown:
        raise ValueError(f"a row has keys that are no column: {', '.join(sorted(unknown))}")
    shown = [key for key in columns if any(row.get(key) for row in rows)]
    lines = [[columns[key] for key in shown], ["---"] * len(shown)]
    lines += [[cell(key, row.get(key)) for key in shown] for row in rows]
    return "\n".join("|" + "|".join(line) + "|" for line in lines)


def cell(key: str, value: object) -> str:
    """A command as code, all else as it is written."""
    if value is None:
        return ""
    return f"`{value}`" if key == "command" else str(value)


def main() -> None:
    """Write both pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--docs", type=Path, default=DOCS, help="folder of the documentation")
    docs = parser.parse_args().docs
    for name in PAGES:
        data = yaml.safe_load((docs / "studies" / f"{name}.yaml").read_text(encoding="utf-8"))
        (docs / f"{name}.md").write_text(page(data), encoding="utf-8")


if __name__ == "__main__":
    main()
