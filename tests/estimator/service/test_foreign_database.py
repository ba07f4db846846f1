"""A file that is no database of the service, or a damaged one, is refused in one sentence and stays as it is to the byte."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from estimator.cli.main import main
from estimator.errors import CorruptStore, InvalidInput
from estimator.service import database as database_module
from estimator.service.app import create_app
from estimator.service.core import DATABASE
from estimator.service.database import APPLICATION_ID, Database, check_database
from estimator.service.settings import Settings
from estimator.service.tokens import Scope, all_tokens, create_token


def own(path: Path) -> None:
    database = Database(path)
    database.migrate()
    for n in range(200):
        create_token(database, f"user{n}", Scope.READ, 1.0)
    database.close()


def alter(path: Path, *commands: str) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        for command in commands:
            database.execute(command)


def notes(path: Path) -> None:
    alter(path, "CREATE TABLE notes (text TEXT)", "INSERT INTO notes VALUES ('mine')")


def of_alembic(path: Path) -> None:
    """Of another program that uses Alembic, with the same name of its first version."""
    notes(path)
    alter(
        path, "CREATE TABLE alembic_version (version_num TEXT)", "INSERT INTO alembic_version VALUES ('0001')"
    )


def same_tables(path: Path) -> None:
    of_alembic(path)
    alter(path, "CREATE TABLE tokens (id TEXT, user TEXT)", "CREATE TABLE sessions (id TEXT, hash TEXT)")


def named(path: Path) -> None:
    notes(path)
    alter(path, "PRAGMA application_id=1196444487")  # a GeoPackage


def in_wal(path: Path) -> None:
    alter(path, "PRAGMA journal_mode=WAL")
    notes(path)


def newer(path: Path) -> None:
    own(path)
    alter(path, "UPDATE alembic_version SET version_num = '9999'", "PRAGMA wal_checkpoint(TRUNCATE)")


def without_version(path: Path) -> None:
    own(path)
    alter(path, "DELETE FROM alembic_version", "PRAGMA wal_checkpoint(TRUNCATE)")


def replaced(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def words(path: Path) -> None:
    replaced(path, b"not a database, but long enough to be one " * 500)


def overwritten(path: Path, begin: int, length: int) -> None:
    own(path)
    content = bytearray(path.read_bytes())
    content[begin : begin + length] = b"\xa5" * length
    path.write_bytes(content)


FILES: dict[str, tuple[Callable[[Path], None], int]] = {
    "another program's": (notes, 2),
    "another program's with Alembic": (of_alembic, 2),
    "another program's with tables of the same names": (same_tables, 2),
    "another program's with an id": (named, 2),
    "another program's in WAL": (in_wal, 2),
    "a newer coilcal's": (newer, 2),
    "one without a version": (without_version, 3),
    "words": (words, 3),
    "a header and nothing else": (lambda path: replaced(path, b"SQLite format 3\0" + b"\1" * 84), 3),
    "one without its middle": (lambda path: overwritten(path, 4096, 8192), 3),
    "one with a damaged page": (lambda path: overwritten(path, 20_000, 20_000), 3),
}  # fmt: skip


def states(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def serve(*words: object) -> Result:
    return CliRunner().invoke(main, ["serve", *map(str, words)])


@pytest.mark.parametrize("name", FILES)
def test_no_command_touches_it(tmp_path, name):
    make, exit_code = FILES[name]
    data = tmp_path / "data"
    data.mkdir()
    make(data / DATABASE)
    before = states(data)
    for words in (
        ("token", "create", "--user", "anne"),
        ("token", "list"),
        ("token", "revoke", "x"),
        ("backup", tmp_path / "b.tar"),
        ("--check", "--host", "0.0.0.0"),
        ("--port", "0"),
    ):
        result = serve(*words, "--data", data)
        assert result.exit_code == exit_code, (words, result.output, result.exception)
        (sentence,) = result.stderr.splitlines()
        assert sentence.startswith("coilcal: database must be"), sentence
        assert states(data) == before, words
    with pytest.raises((InvalidInput, CorruptStore)):
        create_app(Settings(data=data))
    assert states(data) == before
    assert not (tmp_path / "b.tar").exists()


def test_one_that_another_program_uses_now_is_left_alone(tmp_path):
    path = tmp_path / DATABASE
    in_wal(path)
    with closing(sqlite3.connect(path, isolation_level=None)) as theirs:
        theirs.execute("INSERT INTO notes VALUES ('more')")
        assert path.with_name(f"{DATABASE}-wal").stat().st_size > 0
        before = path.read_bytes(), path.with_name(f"{DATABASE}-wal").read_bytes()
        assert serve("token", "list", "--data", tmp_path).exit_code == 2
        assert (path.read_bytes(), path.with_name(f"{DATABASE}-wal").read_bytes()) == before
        assert theirs.execute("SELECT count(*) FROM notes").fetchone() == (2,)


def test_one_into_which_another_process_begins_to_write_is_read_again(tmp_path, monkeypatch):
    path = tmp_path / DATABASE
    own(path)
    asked: list[str] = []
    original = database_module._check_tables

    def check(connection: sqlite3.Connection, of: Path) -> None:
        asked.append("")
        if len(asked) == 1:  # pages of two moments
            path.with_name(f"{DATABASE}-wal").touch()
            raise sqlite3.DatabaseError("database disk image is malformed")
        original(connection, of)

    monkeypatch.setattr(database_module, "_check_tables", check)
    check_database(path)
    assert len(asked) == 2


def test_those_of_the_service_are_taken_with_and_without_an_id_and_while_it_runs(tmp_path):
    path = tmp_path / DATABASE
    own(path)
    assert path.read_bytes()[68:72] == APPLICATION_ID.to_bytes(4, "big")
    alter(path, "PRAGMA application_id=0")  # as an earlier version has left it
    database = Database(path)
    database.migrate()
    assert len(all_tokens(database)) == 200
    create_token(database, "anne", Scope.READ, 1.0)  # in the log beside the file
    assert path.with_name(f"{DATABASE}-wal").exists()
    assert serve("token", "list", "--data", tmp_path).stdout.count("\n") == 202
    database.close()
    assert path.read_bytes()[68:72] == APPLICATION_ID.to_bytes(4, "big")


@pytest.mark.parametrize("content", [b"", None])
def test_what_a_kill_at_the_first_start_leaves_is_gone_on_with(tmp_path, content):
    path = tmp_path / DATABASE
    if content is None:
        alter(path, "PRAGMA journal_mode=WAL")
    else:
        path.write_bytes(content)
    assert serve("token", "create", "--user", "anne", "--data", tmp_path).exit_code == 0


def test_options_in_front_of_a_subcommand_count_or_are_refused(tmp_path, monkeypatch):
    """`--data` was ignored there, so that a token was made in another folder."""
    monkeypatch.chdir(tmp_path)
    x, y = Path("x").absolute(), Path("y").absolute()
    assert serve("--data", x, "token", "create", "--user", "anne").exit_code == 0
    assert serve("--data", x, "backup", "b.tar").exit_code == 0
    assert serve("--data", y, "restore", "b.tar").exit_code == 0
    Path("service.yaml").write_text(f"data: {y}\n", encoding="utf-8")
    assert "anne" in serve("--config", "service.yaml", "token", "list").stdout
    assert "anne" in serve("--data", y, "token", "list", "--data", y).stdout
    refused = serve("--data", x, "token", "list", "--data", y)
    assert (refused.exit_code, "--data must be given once" in refused.stderr) == (2, True)
    for option in (
        ("--port", 1),
        ("--host", "::1"),
        ("--workers", 1),
        ("--open",),
        ("--check",),
        ("--json",),
    ):
        refused = serve(*option, "--data", x, "token", "list")
        assert (refused.exit_code, f"{option[0]} must stand behind token" in refused.stderr) == (2, True)
    assert sorted(path.name for path in Path().iterdir()) == ["b.tar", "service.yaml", "x", "y"]


def test_only_a_new_token_makes_a_folder(tmp_path):
    for words in (("token", "list"), ("token", "revoke", "x"), ("backup", tmp_path / "b.tar")):
        result = serve(*words, "--data", tmp_path / "typo")
        assert (result.exit_code, "must be the folder of a service" in result.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == []
