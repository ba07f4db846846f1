"""Schedules of recalibration.

Revision ID: 0004
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Make the table."""
    op.create_table(
        "schedules",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("rig_name", sa.String(), nullable=False),
        sa.Column("cron", sa.String()),
        sa.Column("every_s", sa.Integer()),
        sa.Column("timezone", sa.String(), nullable=False),
        sa.Column("seed", sa.Integer(), nullable=False),
        sa.Column("created", sa.String(), nullable=False),
        sa.Column("user", sa.String(), nullable=False),
        sa.Column("next_run", sa.String(), nullable=False),
        sa.Column("last_run", sa.String()),
        sa.Column("is_at_work", sa.Boolean(), nullable=False),
    )
    op.create_index("ix_schedules_next_run", "schedules", ["next_run"])


def downgrade() -> None:
    """Drop the table."""
    op.drop_table("schedules")
