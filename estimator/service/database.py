"""The database: SQLite in WAL mode, its migrations, and transactions."""

from __future__ import annotations

import sqlite3
import uuid
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

from alembic.config import Config
from alembic.runtime.environment import EnvironmentContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import DBAPIError
from sqlalchemy.orm import Session

from estimator.errors import CoilcalError, CorruptStore, InvalidInput, reason

MIGRATIONS = Path(__file__).parent / "migrations"
PATIENCE_S = 30  # a write waits this long for another one
WRITES = "coilcal_writes"
APPLICATION_ID = 0x636F696C  # "coil", in the header of the file
MAGIC = b"SQLite format 3\0"
# Columns that every version of the schema has had; files from before 2026-11-28 have no application id.
FIRST_TABLES = {
    "tokens": {"id", "user", "scope", "hash", "created", "expires", "revoked"},
    "rig_versions": {"id", "name", "hash", "text", "created", "user"},
    "sessions": {"id", "rig_id", "source", "state", "created", "user", "n_readings", "hash"},
    "audit": {"number", "time", "user", "token_id", "request_id", "action", "target"},
}


class Database:
    """Transactions on one file.

    Args:
        path: The file; it is made, and brought to the present schema, by `migrate`.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reading = _engine(path)
        self._writing = self._reading.execution_options(**{WRITES: True})

    def migrate(self, revision: str = "head") -> None:
        """Bring the schema to a revision; an interrupted migration leaves the schema as it was.

        Raises:
            InvalidInput: The file is that of another program or of a newer coilcal, or it cannot be written; it is as it was.
            CorruptStore: It is damaged.
        """
        check_database(self._path)
        try:
            self._migrate(revision)
        except (DBAPIError, sqlite3.Error) as error:
            raise explained(self._path, error) from error

    def _migrate(self, revision: str) -> None:
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
            if connection.exec_driver_sql("PRAGMA application_id").scalar() != APPLICATION_ID:
                connection.exec_driver_sql(f"PRAGMA application_id={APPLICATION_ID}")

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


def check_database(path: Path) -> None:
    """Refuse a file that is no database of the service; nothing is written. One that is not there, or is empty, is about to be made.

    Raises:
        InvalidInput: It is that of another program or of a newer coilcal, or it cannot be read.
        CorruptStore: It is damaged.
    """
    try:
        if not path.exists():
            return
        if not path.is_file():
            raise InvalidInput(f"database must be a file; {path} is none")
        with path.open("rb") as file:
            begin = file.read(len(MAGIC))
    except OSError as error:
        raise InvalidInput(f"database must be readable; {path} is not: {reason(error)}") from error
    if not begin:
        return
    if begin != MAGIC:
        raise CorruptStore(f"database must be one of SQLite; {path} is none")
    if _is_alone(path):
        try:
            _check_content(
                path, "immutable=1"
            )  # as it lies there: no log is made beside it, and no lock is taken
            return
        except CoilcalError:
            if _is_alone(path):  # else another process has begun to write while it was read
                raise
    _check_content(path, "mode=ro")


def _is_alone(path: Path) -> bool:
    """Whether no process has a database open, and no kill has left its log."""
    return not path.with_name(path.name + "-wal").exists()


def _check_content(path: Path, how: str) -> None:
    address = f"file:{quote(str(path.absolute()))}?{how}"
    try:
        with closing(sqlite3.connect(address, uri=True, timeout=PATIENCE_S)) as connection:
            _check_tables(connection, path)
    except sqlite3.Error as error:
        raise explained(path, error) from error


def _check_tables(connection: sqlite3.Connection, path: Path) -> None:
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    (application_id,) = connection.execute("PRAGMA application_id").fetchone()
    if not tables and application_id in (0, APPLICATION_ID):  # a kill came before the first migration
        return
    is_old = application_id == 0 and all(
        columns <= {row[1] for row in connection.execute(f"PRAGMA table_info({table})")}
        for table, columns in FIRST_TABLES.items()
    )
    if application_id != APPLICATION_ID and not is_old:
        raise InvalidInput(f"database must be one of coilcal serve; {path} is that of another program")
    for (fault,) in connection.execute("PRAGMA quick_check(1)"):
        if fault != "ok":
            raise CorruptStore(f"database must be whole; {path} is damaged")
    revisions = [word for (word,) in connection.execute("SELECT version_num FROM alembic_version")]
    known = {file.name[1:5] for file in MIGRATIONS.glob("versions/v*.py")}
    if len(revisions) != 1:
        raise CorruptStore(f"database must be of one version; {path} names {len(revisions)}")
    if revisions[0] not in known:
        words = f"database must be of version {max(known)} at most; {path} is of {str(revisions[0])[:20]!r}"
        raise InvalidInput(f"{words} (a newer coilcal has made it)")


def explained(path: Path, error: Exception) -> InvalidInput | CorruptStore:
    """The refusal for what SQLite raises about a file."""
    cause = error.orig if isinstance(error, DBAPIError) else error
    code = getattr(cause, "sqlite_errorcode", None)
    primary = None if code is None else code & 0xFF
    if primary in (sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED):
        return InvalidInput(f"database must be free; another program holds {path}")
    if primary in (
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_READONLY,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_CANTOPEN,
    ):
        return InvalidInput(f"database must be readable and writable; {path} is not: {cause}")
    return CorruptStore(f"database must be whole; {path} is damaged: {cause}")


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
