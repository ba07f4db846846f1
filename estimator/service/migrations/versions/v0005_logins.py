"""Logins of browsers, which end at a logout.

Revision ID: 0005
"""

from __future__ import annotations

from alembic import op

from estimator.service.columns import key, reference, texts

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Make the table."""
    op.create_table("logins", key(), reference("logins", "token_id", "tokens"), *texts("created"))
    op.create_index("ix_logins_created", "logins", ["created"])
