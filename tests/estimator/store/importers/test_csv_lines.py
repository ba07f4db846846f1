"""A line of a CSV is a row: no quote takes a line end into a cell, and a million rows take seconds."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.errors import InvalidInput
from estimator.store.importers import csv_lines
from estimator.store.importers.csv_lines import BadLine, cells_of, csv_blocks

CELL = st.text(st.characters(blacklist_characters="\r\n\0", blacklist_categories=["Cs"]), max_size=6)


@given(st.lists(CELL, min_size=2, max_size=6))
def test_cells_are_those_that_were_written(cells: list[str]) -> None:
    line = io.StringIO()
    csv.writer(line, lineterminator="").writerow(cells)
    assert cells_of(line.getvalue(), Path("readings.csv"), 1) == cells


@pytest.mark.parametrize(
    ("line", "cell"),
    [('1,2,"day', 3), ('1,2"', 2), ('"1"2,3', 1), ('"', 1), ('1,"a""', 2), ('1, "a"', 2)],
)
def test_a_quote_that_encloses_no_cell_is_refused(line, cell):
    with pytest.raises(
        InvalidInput, match=rf"cell {cell} has one too many or too few \(readings.csv, line 7\)"
    ) as caught:
        cells_of(line, Path("readings.csv"), 7)
    assert caught.value.place is not None
    assert (caught.value.place.line, caught.value.place.column) == (7, cell)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("last", [True, False])
@pytest.mark.parametrize("size", [1, 7, 100_000])
def test_no_row_is_lost_between_blocks(tmp_path, monkeypatch, end, last, size):
    monkeypatch.setattr(csv_lines, "BLOCK_BYTES", size)
    lines = [f"{i},µ{i}" for i in range(500)]
    lines[17] = ""
    lines[18] = '18,"µ18"'
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbf" + (end.join(lines) + end * last).encode())
    rows, numbers = [], []
    for block in csv_blocks(tmp_path / "a.csv"):
        columns, of_rows = block.columns(2, [])
        rows += list(zip(*columns, strict=True))
        numbers += list(of_rows)
    assert rows == [(str(i), f"µ{i}") for i in range(500) if i != 17]
    assert numbers == [i for i in range(1, 501) if i != 18]


def test_two_lines_that_make_up_for_each_other_are_told_both(tmp_path):
    (tmp_path / "a.csv").write_text("1,2\n3\n4,5,6\n7,8\n")
    bad_lines: list[BadLine] = []
    (block,) = csv_blocks(tmp_path / "a.csv")
    columns, numbers = block.columns(2, bad_lines)
    assert list(zip(*columns, strict=True)) == [("1", "2"), ("7", "8")]
    assert list(numbers) == [1, 4]
    assert [(bad.number, bad.received) for bad in bad_lines] == [(2, "1"), (3, "3")]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"t_s\n1\n\xb5\n", "'utf-8' has no byte 0xb5, as in line 3; save it in UTF-8"),
        ("t_s\n1\n".encode("utf-16"), "it is in UTF-16; save it in UTF-8"),
    ],
)
def test_another_encoding_is_told_with_its_line(tmp_path, content, words):
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(InvalidInput, match=words):
        list(csv_blocks(tmp_path / "a.csv"))
