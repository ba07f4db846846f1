"""Sessions are begun once, however often a client asks: the key of its request.

Revision ID: 0002
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Add the key. An index and no constraint, for which SQLite would have to make the table anew, against its foreign keys."""
    op.add_column("sessions", sa.Column("idempotency_key", sa.String()))
    op.create_index("ix_sessions_key", "sessions", ["user", "idempotency_key"], unique=True)
