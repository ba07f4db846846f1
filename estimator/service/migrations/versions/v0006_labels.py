"""Names, notes and tags of sessions and jobs, and when a session was measured.

Revision ID: 0006
"""

from __future__ import annotations

from alembic import op

from estimator.service.columns import texts

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Add the columns."""
    for table, names in (
        ("sessions", ("name", "note", "tags", "measured")),
        ("jobs", ("name", "note", "tags")),
    ):
        for column in texts(*names, nullable=True):
            op.add_column(table, column)
