"""What a page shows of a table before it is imported."""

from __future__ import annotations

from pathlib import Path

from estimator.rig_files.read import rig_from_text
from estimator.store.importers.forms.preview import previewed
from estimator.store.importers.forms.recipe import Recipe
from tests.estimator.store.importers.forms.written import RIG, text


def test_all_faults_of_a_table_are_told_with_their_lines(tmp_path: Path) -> None:
    rows = text().splitlines()
    rows[5] = ",".join(["x", *rows[5].split(",")[1:]])
    rows[9] += ",1"
    (tmp_path / "a.csv").write_text("\n".join(rows), encoding="utf-8")
    preview = previewed(tmp_path / "a.csv", rig_from_text(RIG), Recipe())
    first, second = preview.fault.splitlines()
    assert first.startswith("t_s must be a finite number; received 'x'")
    assert "a.csv, line 6" in first
    assert second.startswith("a row must have 8 cells like the header; received 9")
    assert "a.csv, line 10" in second
    assert preview.n_readings is None
    assert len(preview.columns) == 8
