"""Logins of browsers, which end at a logout.

Revision ID: 0005
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Make the table."""
    op.create_table(
        "logins",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column(
            "token_id", sa.String(), sa.ForeignKey("tokens.id", name="fk_logins_token_id"), nullable=False
        ),
        sa.Column("created", sa.String(), nullable=False),
    )
    op.create_index("ix_logins_created", "logins", ["created"])


def downgrade() -> None:
    """Drop the table."""
    op.drop_table("logins")
