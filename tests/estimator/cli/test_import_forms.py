"""A file that is no readings CSV: what was understood is shown, asked once, and kept as a recipe that is used again."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click
import pytest

from estimator.readings.clock import Clock
from estimator.store.importers.forms.recipe import Recipe, read_recipe
from tests.estimator.cli.conftest import run
from tests.estimator.store.importers.forms.written import RIG, TABLE, columns, text, workbook

HEADER = [
    "Time [s]",
    "I coil (A)",
    "X [mm]",
    "Y [mm]",
    "Z [mm]",
    "Hall Bx/uT",
    "Hall By/uT",
    "Hall Bz/uT",
    "Comment",
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_text(RIG, encoding="utf-8")
    table = columns(HEADER, *TABLE.T, ["ok"] * 60, separator=";").replace(".", ",")
    (tmp_path / "mine.csv").write_text("Lab 3\n" + table, encoding="latin-1")
    (tmp_path / "plain.csv").write_text(text(), encoding="utf-8")
    return tmp_path


CALL = ("import", "mine.csv", "--rig", "rig.yaml", "--out", "session.zarr")


def test_in_a_pipe_what_was_understood_has_to_be_accepted(folder):
    refused = run(*CALL)
    assert refused.exit_code == 2
    lines = refused.stderr.splitlines()
    assert (
        "separated by semicolons, with decimal commas; names of columns in line 2; 1 more line above"
        in lines[0]
    )
    assert lines[0].endswith("Left out: Comment.")
    assert lines[4].split() == [
        "X",
        "[mm]",
        "stage_x_mm",
        *(part for row in TABLE[:3] for part in (f"{row[2] / 1e3:.6g}", "m")),
    ]
    assert lines[-1].startswith(
        "coilcal: mine.csv is no readings CSV, so what was understood of it must be accepted: add --yes"
    )
    assert sorted(path.name for path in folder.iterdir()) == ["mine.csv", "plain.csv", "rig.yaml"]


def test_a_recipe_reads_the_next_file_without_a_question(folder):
    first = json.loads(run(*CALL, "--yes", "--json").stdout)
    assert first["columns"] == "columns.yaml"
    again = json.loads(run(*CALL[:-1], "again.zarr", "--map", "columns.yaml", "--json").stdout)
    assert (again["session_hash"], again["columns"]) == (first["session_hash"], None)
    assert read_recipe(folder / "columns.yaml").columns["Hall Bx/uT"] == "Bx_uT"
    changed = (folder / "columns.yaml").read_text().replace("Bx_uT", "Bx_mT")
    (folder / "columns.yaml").write_text(changed)
    other = json.loads(run(*CALL[:-1], "other.zarr", "--map", "columns.yaml", "--json").stdout)
    assert other["session_hash"] != first["session_hash"]
    run(*CALL, "--yes", "--overwrite")
    assert (folder / "columns.yaml").read_text() == changed, "a recipe that somebody has changed stays"
    assert (folder / "session.columns.yaml").exists()


def test_on_a_terminal_it_is_asked_once(folder, monkeypatch):
    asked: list[str] = []
    answers = iter((False, True))

    def confirm(question: str, **_: Any) -> bool:
        asked.append(question)
        return next(answers)

    monkeypatch.setattr("estimator.cli.proposal.is_terminal", lambda: True)
    monkeypatch.setattr(click, "confirm", confirm)
    assert "say what they are with --column" in run(*CALL).stderr
    assert run(*CALL).exit_code == 0
    assert asked == ["Import it so?"] * 2
    assert run(*CALL[:1], "plain.csv", *CALL[2:-1], "plain.zarr").exit_code == 0
    assert len(asked) == 2, "a readings CSV needs no question"
    assert (folder / "columns.yaml").exists()


def test_wild_rows_and_clocks_are_told_by_check_and_import(folder):
    rows = TABLE.copy()
    rows[40:, 0] -= 15.25
    rows[13, 5:] = [266000.5, -31000.25, 77000.125]
    (folder / "mine.csv").write_text(text(rows=rows), encoding="utf-8")
    for told in (run("check", "rig.yaml", "mine.csv").stdout, run(*CALL).stdout):
        assert "Time jumps back in line 42 (to 4.75 s)" in told
        assert "Line 15: much farther from the rig's nominal model than the others" in told


def test_a_package_that_is_missing_is_named_with_the_command(folder, monkeypatch):
    book = workbook({"Data": [HEADER[:8], *TABLE.tolist()]}) or b"PK"
    if book == b"PK":
        pytest.skip("needs openpyxl")
    (folder / "mine.xlsx").write_bytes(book)
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    sentence = run("import", "mine.xlsx", *CALL[2:]).stderr
    assert "install it with: pip install 'coilcal[files]' (mine.xlsx)" in sentence


def test_a_recipe_is_read_as_it_was_written(tmp_path):
    recipe = Recipe(
        {"Zeit [ms]": "t_ms", "no": "-", 'a "b": c': "Bx_mT", "Uhr": "clock"},
        {"coil1_current_A": 3.0},
        "semicolons",
        "comma",
        "cp1252",
        "Data 1",
        Clock.SPREAD,
        True,
        is_whole=True,
        origin=str(tmp_path / "columns.yaml"),
    )
    (tmp_path / "columns.yaml").write_text(recipe.text(), encoding="utf-8")
    assert read_recipe(tmp_path / "columns.yaml") == recipe


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            ("Bx_uT", "Bx_furlong"),
            "column 'Hall Bx/uT' must be one that the rig knows; received 'Bx_furlong'",
        ),
        (("Bx_uT", "Bx_mm"), "must have a unit of field at the end of its name"),
        (("Hall Bx/uT", "Hall B1/uT"), "column 'Hall B1/uT' of columns.yaml must be in the file"),
        (("semicolons", "dots"), "separator must be one of commas, semicolons"),
        (("cp1252", "cp9999"), "encoding must be one that Python knows; received 'cp9999'"),
        (("schema_version: 1", "schema_version: 2"), "schema_version must be 1; received 2"),
    ],
)
def test_a_recipe_with_a_mistake_is_refused(folder: Path, change: tuple[str, str], words: str) -> None:
    run(*CALL, "--yes")
    recipe = (folder / "columns.yaml").read_text(encoding="utf-8").replace("utf-8", "cp1252")
    assert change[0] in recipe
    (folder / "columns.yaml").write_text(recipe.replace(*change), encoding="utf-8")
    refused = run(*CALL[:-1], "new.zarr", "--map", "columns.yaml")
    assert refused.exit_code == 2
    assert words in refused.stderr
