"""Results and performance are the pages that the script writes from their rows."""

from __future__ import annotations

import pytest
import yaml

from scripts.documentation.tables import DOCS, PAGES, page, table

COLUMNS = {"what": "What", "target": "Target", "result": "Result", "command": "Command"}


@pytest.mark.parametrize("name", PAGES)
def test_page_is_what_the_script_writes(name):
    data = yaml.safe_load((DOCS / "studies" / f"{name}.yaml").read_text(encoding="utf-8"))
    written = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    assert written == page(data), "run `make results`"


def test_results_fit_on_200_lines():
    assert len((DOCS / "results.md").read_text(encoding="utf-8").splitlines()) <= 200


def written(*rows: dict[str, str]) -> str:
    section = {"title": "S", "command": "make a", "rows": list(rows)}
    return page({"title": "T", "columns": COLUMNS, "text": "x", "sections": [section]})


def test_key_that_is_no_column_is_refused():
    with pytest.raises(ValueError, match="resutl"):
        table(COLUMNS, [{"what": "a", "resutl": "1"}])
