"""The database: an old one gets what it lacks, commits are durable, writers wait for each other."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import Index, select, text
from sqlalchemy.exc import IntegrityError

from estimator.errors import CorruptStore
from estimator.service.database import Database, new_id, now
from estimator.service.schema import Audit, SessionRow


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    database = Database(tmp_path / "a 100 % odd name.sqlite")
    database.migrate()
    yield database
    database.close()


FIRST = {
    "rig_versions": "('r1', 'small', 'h1', 'schema_version: 1', '2026-01-01', 'anne')",
    "sessions": "('s1', 'r1', 'bench', 'closed', '2026-01-02', 'anne', 36, 'h2')",
    "jobs": "(1, 'j1', 'anne', 'calibrate', 'done', 's1', NULL, '{}', 'k', '2026-01-03', NULL, NULL, 1, NULL)",
    "calibrations": "('c1', 'j1', 's1', 'small', '2026-01-04', 'anne')",
    "tokens": "('t1', 'anne', 'read', 'h3', '2026-01-01', '2027-01-01', NULL)",
    "audit": "(1, '2026-01-01', 'anne', NULL, 'q', 'rig.upload', 'r1')",
}  # fmt: skip


def made(path: Path) -> dict[str, set[str]]:
    """Columns of each table, and the indexes."""
    with closing(sqlite3.connect(path)) as connection:
        names = [
            name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        ]
        columns = {
            name: {str(row[1:4]) for row in connection.execute(f"PRAGMA table_info({name})")}
            for name in names
        }
        indexes = connection.execute("SELECT sql FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL")
        return columns | {"indexes": {sql for (sql,) in indexes}}


def test_a_database_of_the_first_version_becomes_as_a_new_one_with_its_rows(database, tmp_path):
    path = tmp_path / "old.sqlite"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(Path(__file__).with_name("first_schema.sql").read_text(encoding="utf-8"))
        for table, row in FIRST.items():
            connection.execute(f"INSERT INTO {table} VALUES {row}")
        connection.commit()
    old = Database(path)
    old.migrate()
    assert made(path) == made(Path(str(database.engine.url.database)))
    with old.engine.connect() as connection:
        assert connection.execute(text("SELECT version_num FROM alembic_version")).all() == [("0006",)]
        for table in FIRST:
            assert connection.execute(text(f"SELECT count(*) FROM {table}")).scalar() == 1, table
        assert connection.execute(text("PRAGMA foreign_key_check")).all() == []
    with old.reading() as db:
        session = db.get_one(SessionRow, "s1")
        assert (session.rig_id, session.n_readings, session.idempotency_key) == ("r1", 36, None)
    old.close()


def test_what_cannot_be_added_whole_is_not_added_at_all(tmp_path, monkeypatch):
    path = tmp_path / "old.sqlite"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(Path(__file__).with_name("first_schema.sql").read_text(encoding="utf-8"))
    before = made(path)

    def fail(*_: object, **__: object) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    monkeypatch.setattr(Index, "create", fail)
    database = Database(path)
    with pytest.raises(CorruptStore):
        database.migrate()
    database.close()
    assert made(path) == before


def test_wal_full_synchronisation_and_foreign_keys_are_on(database):
    with database.engine.connect() as connection:
        asked = [
            connection.execute(text(f"PRAGMA {name}")).scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys")
        ]
    assert asked == ["wal", 2, 1]


def test_a_session_needs_its_rig_and_a_failed_write_leaves_nothing(database):
    def add() -> None:
        with database.writing() as db:
            db.add(Audit(time=now(), user="u", request_id="r", action="a", target="t"))
            db.flush()
            db.add(SessionRow(id=new_id(), rig_id="none", source="s", state="open", created=now(), user="u"))

    with pytest.raises(IntegrityError):
        add()
    with database.reading() as db:
        assert db.scalars(select(Audit)).all() == []


def test_writers_that_read_first_wait_for_each_other(database):
    """With a transaction that begins as a read, SQLite refuses the later one at once."""

    def count_and_add(_: int) -> int:
        with database.writing() as db:
            n = len(db.scalars(select(Audit)).all())
            db.add(Audit(time=now(), user="u", request_id=str(n), action="a", target="t"))
            return n

    with ThreadPoolExecutor(8) as pool:
        assert sorted(pool.map(count_and_add, range(40))) == list(range(40))
