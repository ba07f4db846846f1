"""What a page shows of a table before it is imported."""

from __future__ import annotations

from estimator.rig_files.read import rig_from_text
from estimator.store.importers.forms.preview import previewed
from estimator.store.importers.forms.recipe import Recipe
from tests.estimator.store.importers.forms.written import HEADER, RIG, TWO_COILS, text


def test_all_faults_of_a_table_are_told_with_their_lines(tmp_path):
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


def test_one_current_of_two_coils_is_offered_to_both_whichever_is_missed(tmp_path):
    (tmp_path / "a.csv").write_text(text([*HEADER[:1], "I [A]", *HEADER[2:]]), encoding="utf-8")
    preview = previewed(tmp_path / "a.csv", rig_from_text(TWO_COILS), Recipe())
    first, second = preview.fault.splitlines()
    for sentence, coil in ((first, "coil1"), (second, "coil2")):
        assert f"say which with --column 'I [A]={coil}_current_A'" in sentence
        assert "in series --column 'I [A]=coil1_current_A, coil2_current_A'" in sentence
