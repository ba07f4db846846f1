"""The first schema.

Revision ID: 0001
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Make all tables."""
    op.create_table(
        "tokens",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("user", sa.String(), nullable=False),
        sa.Column("scope", sa.String(), nullable=False),
        sa.Column("hash", sa.String(), nullable=False),
        sa.Column("created", sa.String(), nullable=False),
        sa.Column("expires", sa.String(), nullable=False),
        sa.Column("revoked", sa.String()),
        sa.UniqueConstraint("hash", name="uq_tokens_hash"),
    )
    op.create_table(
        "rig_versions",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column("name", sa.String(), nullable=False),
        sa.Column("hash", sa.String(), nullable=False),
        sa.Column("text", sa.String(), nullable=False),
        sa.Column("created", sa.String(), nullable=False),
        sa.Column("user", sa.String(), nullable=False),
        sa.UniqueConstraint("hash", name="uq_rig_versions_hash"),
    )
    op.create_index("ix_rig_versions_name", "rig_versions", ["name"])
    op.create_table(
        "sessions",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column(
            "rig_id", sa.String(), sa.ForeignKey("rig_versions.id", name="fk_sessions_rig_id"), nullable=False
        ),
        sa.Column("source", sa.String(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column("created", sa.String(), nullable=False),
        sa.Column("user", sa.String(), nullable=False),
        sa.Column("n_readings", sa.Integer()),
        sa.Column("hash", sa.String()),
    )
    op.create_index("ix_sessions_rig_id", "sessions", ["rig_id"])
    op.create_index("ix_sessions_hash", "sessions", ["hash"])
    op.create_table(
        "jobs",
        sa.Column("number", sa.Integer(), primary_key=True, autoincrement=True),
        sa.Column("id", sa.String(), nullable=False),
        sa.Column("user", sa.String(), nullable=False),
        sa.Column("kind", sa.String(), nullable=False),
        sa.Column("state", sa.String(), nullable=False),
        sa.Column(
            "session_id", sa.String(), sa.ForeignKey("sessions.id", name="fk_jobs_session_id"), nullable=False
        ),
        sa.Column("rig_id", sa.String(), sa.ForeignKey("rig_versions.id", name="fk_jobs_rig_id")),
        sa.Column("options", sa.JSON(), nullable=False),
        sa.Column("idempotency_key", sa.String()),
        sa.Column("created", sa.String(), nullable=False),
        sa.Column("started", sa.String()),
        sa.Column("ended", sa.String()),
        sa.Column("starts", sa.Integer(), nullable=False),
        sa.Column("fault", sa.String()),
        sa.UniqueConstraint("id", name="uq_jobs_id"),
        sa.UniqueConstraint("user", "idempotency_key", name="uq_jobs_key"),
    )
    op.create_index("ix_jobs_user", "jobs", ["user"])
    op.create_index("ix_jobs_session_id", "jobs", ["session_id"])
    op.create_index("ix_jobs_queue", "jobs", ["state", "number"])
    op.create_table(
        "calibrations",
        sa.Column("id", sa.String(), primary_key=True),
        sa.Column(
            "job_id", sa.String(), sa.ForeignKey("jobs.id", name="fk_calibrations_job_id"), nullable=False
        ),
        sa.Column(
            "session_id",
            sa.String(),
            sa.ForeignKey("sessions.id", name="fk_calibrations_session_id"),
            nullable=False,
        ),
        sa.Column("rig_name", sa.String(), nullable=False),
        sa.Column("created", sa.String(), nullable=False),
        sa.Column("user", sa.String(), nullable=False),
        sa.UniqueConstraint("job_id", name="uq_calibrations_job_id"),
    )
    op.create_index("ix_calibrations_session_id", "calibrations", ["session_id"])
    op.create_index("ix_calibrations_rig_name", "calibrations", ["rig_name"])
    op.create_table(
        "audit",
        sa.Column("number", sa.Integer(), primary_key=True, autoincrement=True),
        sa.Column("time", sa.String(), nullable=False),
        sa.Column("user", sa.String(), nullable=False),
        sa.Column("token_id", sa.String()),
        sa.Column("request_id", sa.String(), nullable=False),
        sa.Column("action", sa.String(), nullable=False),
        sa.Column("target", sa.String(), nullable=False),
    )
    op.create_index("ix_audit_time", "audit", ["time"])


def downgrade() -> None:
    """Drop all tables."""
    for table in ("audit", "calibrations", "jobs", "sessions", "rig_versions", "tokens"):
        op.drop_table(table)
