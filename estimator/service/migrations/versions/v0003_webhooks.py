"""Webhooks and what they are told.

Revision ID: 0003
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from estimator.service.columns import key, number, reference, texts

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Make the tables."""
    op.create_table("webhooks", key(), *texts("url", "secret", "created", "user"))
    op.create_table(
        "deliveries",
        number(),
        *texts("id"),
        reference("deliveries", "webhook_id", "webhooks"),
        *texts("event", "body", "created", "state"),
        sa.Column("attempts", sa.Integer(), nullable=False),
        *texts("next_attempt", nullable=True),
        sa.Column("status", sa.Integer()),
        *texts("fault", "ended", nullable=True),
        sa.UniqueConstraint("id", name="uq_deliveries_id"),
    )
    op.create_index("ix_deliveries_webhook_id", "deliveries", ["webhook_id"])
    op.create_index("ix_deliveries_due", "deliveries", ["state", "next_attempt"])
