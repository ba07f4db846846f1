"""Columns as the migrations write them. What a migration made once stays as it is, so these functions never change."""

from __future__ import annotations

import sqlalchemy as sa


def key() -> sa.Column[str]:
    """The id of a row, its primary key."""
    return sa.Column("id", sa.String(), primary_key=True)


def number() -> sa.Column[int]:
    """A number that counts rows, their primary key."""
    return sa.Column("number", sa.Integer(), primary_key=True, autoincrement=True)


def texts(*names: str, nullable: bool = False) -> list[sa.Column[str]]:
    """Columns of text."""
    return [sa.Column(name, sa.String(), nullable=nullable) for name in names]


def reference(table: str, name: str, to: str, nullable: bool = False) -> sa.Column[str]:
    """A column of a table that holds the id of a row of another one.

    Examples:
        >>> reference("jobs", "session_id", "sessions").foreign_keys
        {ForeignKey('sessions.id')}
    """
    other = sa.ForeignKey(f"{to}.id", name=f"fk_{table}_{name}")
    return sa.Column(name, sa.String(), other, nullable=nullable)
