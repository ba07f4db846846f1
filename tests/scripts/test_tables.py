"""Results and performance are the pages that the script writes from their rows."""

from __future__ import annotations

import pytest
import yaml

from scripts.documentation.tables import DOCS, PAGES, page, table

COLUMNS = {"what": "What", "target": "Target", "result": "Result", "command": "Command"}


@pytest.mark.parametrize("name", PAGES)
def test_page_is_what_the_script_writes(name: str) -> None:
    data = yaml.safe_load((DOCS / "studies" / f"{name}.yaml").read_text(encoding="utf-8"))
    written = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    assert written == page(data), "run `make results`"


def test_results_fit_on_200_lines() -> None:
    assert len((DOCS / "results.md").read_text(encoding="utf-8").splitlines()) <= 200


def test_empty_columns_are_left_out_and_commands_are_code() -> None:
    text = table(COLUMNS, [{"what": "a", "result": "1", "command": "make a"}])
    assert text.splitlines() == ["|What|Result|Command|", "|---|---|---|", "|a|1|`make a`|"]


def written(*rows: dict[str, str]) -> str:
    section = {"title": "S", "command": "make a", "rows": list(rows)}
    return page({"title": "T", "columns": COLUMNS, "text": "x", "sections": [section]})


def test_what_all_rows_share_stands_once_above_them() -> None:
    text = written({"what": "a"}, {"what": "b"})
    assert "\n\nCommand: `make a`\n\n|What|\n" in text
    text = written({"what": "a"}, {"what": "b", "command": "make b"})
    assert "\n\nCommand: `make a`; rows that differ say so\n\n" in text
    assert "|a||\n|b|`make b`|" in text


def test_key_that_is_no_column_is_refused() -> None:
    with pytest.raises(ValueError, match="resutl"):
        table(COLUMNS, [{"what": "a", "resutl": "1"}])
