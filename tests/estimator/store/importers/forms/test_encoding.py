"""The encoding of a text: Latin letters of units are not taken for Chinese ones, and Chinese ones are read."""

from __future__ import annotations

import pytest

from estimator.store.importers.forms.encoding import encoding_of


@pytest.mark.parametrize(
    "words",
    [
        "rx [°]",
        "µT",
        "Messung für Spule\nTemp (°C)",
        "X [mm];Temp [°C];Bx [µT]",
        "Größe;Bx [µT]",
        "1;2;Tür auf",
    ],
)
def test_units_of_western_files_are_read(tmp_path, words):
    (tmp_path / "a.csv").write_bytes(words.encode("latin-1"))
    read = (tmp_path / "a.csv").read_text(encoding=encoding_of(tmp_path / "a.csv"))
    assert read == words


@pytest.mark.parametrize(
    ("words", "encoding"),
    [
        ("時間,電流 (A),磁場 Bx (mT)", "shift_jis"),
        ("时间,电流 (A),磁场 Bx (mT)", "gb18030"),
        ("t,µ", "utf-8"),
        ("t,µ", "utf-16-le"),
    ],
)
def test_other_letters_and_unicode_are_read(tmp_path, words, encoding):
    text = "\n".join([words, *["1,2,3"] * 20])
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    assert (tmp_path / "a.csv").read_text(encoding=encoding_of(tmp_path / "a.csv")) == text
