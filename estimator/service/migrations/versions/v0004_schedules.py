"""Schedules of recalibration.

Revision ID: 0004
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from estimator.service.columns import key, texts

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Make the table."""
    op.create_table(
        "schedules",
        key(),
        *texts("rig_name"),
        *texts("cron", nullable=True),
        sa.Column("every_s", sa.Integer()),
        *texts("timezone"),
        sa.Column("seed", sa.Integer(), nullable=False),
        *texts("created", "user", "next_run"),
        *texts("last_run", nullable=True),
        sa.Column("is_at_work", sa.Boolean(), nullable=False),
    )
    op.create_index("ix_schedules_next_run", "schedules", ["next_run"])
