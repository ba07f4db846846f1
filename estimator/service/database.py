"""The database: SQLite in WAL mode, its migrations, and transactions."""

from __future__ import annotations

import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from alembic.config import Config
from alembic.runtime.environment import EnvironmentContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, create_engine, event, make_url
from sqlalchemy.orm import Session

MIGRATIONS = Path(__file__).parent / "migrations"
PATIENCE_S = 30  # a write waits this long for another one
WRITES = "coilcal_writes"


class Database:
    """Transactions on one file.

    Args:
        path: The file; it is made, and brought to the present schema, by `migrate`.
    """

    def __init__(self, path: Path) -> None:
        self._reading = _engine(path)
        self._writing = self._reading.execution_options(**{WRITES: True})

    def migrate(self, revision: str = "head") -> None:
        """Bring the schema to a revision; an interrupted migration leaves the schema as it was."""
        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
        scripts = ScriptDirectory.from_config(config)

        def steps(current: Any, _: Any) -> Any:
            return scripts._upgrade_revs(revision, current)

        with (
            EnvironmentContext(config, scripts, fn=steps, destination_rev=revision) as environment,
            self._writing.begin() as connection,
        ):
            environment.configure(connection=connection, render_as_batch=True)
            environment.run_migrations()

    @contextmanager
    def reading(self) -> Iterator[Session]:
        """A session that sees one state of the database."""
        with Session(self._reading, expire_on_commit=False) as session:
            yield session

    @contextmanager
    def writing(self) -> Iterator[Session]:
        """A session that writes; leaving it commits, an exception rolls back."""
        with Session(self._writing, expire_on_commit=False) as session, session.begin():
            yield session

    @property
    def engine(self) -> Engine:
        """The engine, for tests of the schema."""
        return self._reading

    def close(self) -> None:
        """Give back all connections."""
        self._reading.dispose()


def new_id() -> str:
    """An id that nobody can guess, and that is safe as the name of a folder."""
    return uuid.uuid4().hex


def now() -> str:
    """The present time as the database holds it."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _engine(path: Path) -> Engine:
    engine = create_engine(make_url(f"sqlite:///{path}"), connect_args={"timeout": PATIENCE_S})
    event.listen(engine, "connect", _on_connect)
    event.listen(engine, "begin", _on_begin)
    return engine


def _on_connect(connection: Any, _: Any) -> None:
    """Durable commits, foreign keys, and transactions that begin where SQLAlchemy says so, not where sqlite3 guesses."""
    connection.isolation_level = None
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")


def _on_begin(connection: Connection) -> None:
    """A write takes the lock at once: one that began as a read fails, without waiting, where another has written meanwhile."""
    is_write = connection.get_execution_options().get(WRITES, False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if is_write else "BEGIN")
