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


def test_migrations_make_the_tables_that_the_code_uses(database: Database) -> None:
    with database.engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
        assert connection.execute(text("SELECT version_num FROM alembic_version")).scalar() == "0001"


def test_a_second_migration_changes_nothing(database: Database) -> None:
    with database.writing() as db:
        db.add(Audit(time=now(), user="u", request_id="r", action="a", target="t"))
    database.migrate()
    with database.reading() as db:
        assert len(db.scalars(select(Audit)).all()) == 1


def test_wal_full_synchronisation_and_foreign_keys_are_on(database: Database) -> None:
    with database.engine.connect() as connection:
        asked = [
            connection.execute(text(f"PRAGMA {name}")).scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys")
        ]
    assert asked == ["wal", 2, 1]


def test_a_session_needs_its_rig_and_a_failed_write_leaves_nothing(database: Database) -> None:
    def add() -> None:
        with database.writing() as db:
            db.add(Audit(time=now(), user="u", request_id="r", action="a", target="t"))
            db.flush()
            db.add(SessionRow(id=new_id(), rig_id="none", source="s", state="open", created=now(), user="u"))

    with pytest.raises(IntegrityError):
        add()
    with database.reading() as db:
        assert db.scalars(select(Audit)).all() == []


def test_writers_that_read_first_wait_for_each_other(database: Database) -> None:
    """With a transaction that begins as a read, SQLite refuses the later one at once."""

    def count_and_add(_: int) -> int:
        with database.writing() as db:
            n = len(db.scalars(select(Audit)).all())
            db.add(Audit(time=now(), user="u", request_id=str(n), action="a", target="t"))
            return n

    with ThreadPoolExecutor(8) as pool:
        assert sorted(pool.map(count_and_add, range(40))) == list(range(40))
