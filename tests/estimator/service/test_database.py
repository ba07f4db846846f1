"""The database: its schema is that of the migrations, commits are durable, writers wait for each other."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import select, text
from sqlalchemy.exc import IntegrityError

from estimator.service.database import Database, new_id, now
from estimator.service.schema import Audit, Base, SessionRow


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    database = Database(tmp_path / "a 100 % odd name.sqlite")
    database.migrate()
    yield database
    database.close()


def test_migrations_make_the_tables_that_the_code_uses(database):
    with database.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []


FIRST = {
    "rig_versions": "('r1', 'small', 'h1', 'schema_version: 1', '2026-01-01', 'anne')",
    "sessions": "('s1', 'r1', 'bench', 'closed', '2026-01-02', 'anne', 36, 'h2')",
    "jobs": "(1, 'j1', 'anne', 'calibrate', 'done', 's1', NULL, '{}', 'k', '2026-01-03', NULL, NULL, 1, NULL)",
    "calibrations": "('c1', 'j1', 's1', 'small', '2026-01-04', 'anne')",
    "tokens": "('t1', 'anne', 'read', 'h3', '2026-01-01', '2027-01-01', NULL)",
    "audit": "(1, '2026-01-01', 'anne', NULL, 'q', 'rig.upload', 'r1')",
}  # fmt: skip


def test_rows_of_the_first_schema_survive_every_migration_since(tmp_path):
    database = Database(tmp_path / "old.sqlite")
    database.migrate("0001")
    with database.writing() as db:
        for table, row in FIRST.items():
            db.execute(text(f"INSERT INTO {table} VALUES {row}"))
    database.migrate()
    with database.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
        for table in FIRST:
            assert connection.execute(text(f"SELECT count(*) FROM {table}")).scalar() == 1, table
        assert connection.execute(text("PRAGMA foreign_key_check")).all() == []
    with database.reading() as db:
        session = db.get_one(SessionRow, "s1")
        assert (session.rig_id, session.n_readings, session.idempotency_key) == ("r1", 36, None)
    database.close()


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
