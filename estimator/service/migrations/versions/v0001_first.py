"""The first schema.

Revision ID: 0001
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from estimator.service.columns import key, number, reference, texts

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Make all tables."""
    op.create_table(
        "tokens",
        key(),
        *texts("user", "scope", "hash", "created", "expires"),
        *texts("revoked", nullable=True),
        sa.UniqueConstraint("hash", name="uq_tokens_hash"),
    )
    op.create_table(
        "rig_versions",
        key(),
        *texts("name", "hash", "text", "created", "user"),
        sa.UniqueConstraint("hash", name="uq_rig_versions_hash"),
    )
    op.create_index("ix_rig_versions_name", "rig_versions", ["name"])
    op.create_table(
        "sessions",
        key(),
        reference("sessions", "rig_id", "rig_versions"),
        *texts("source", "state", "created", "user"),
        sa.Column("n_readings", sa.Integer()),
        *texts("hash", nullable=True),
    )
    op.create_index("ix_sessions_rig_id", "sessions", ["rig_id"])
    op.create_index("ix_sessions_hash", "sessions", ["hash"])
    op.create_table(
        "jobs",
        number(),
        *texts("id", "user", "kind", "state"),
        reference("jobs", "session_id", "sessions"),
        reference("jobs", "rig_id", "rig_versions", nullable=True),
        sa.Column("options", sa.JSON(), nullable=False),
        *texts("idempotency_key", nullable=True),
        *texts("created"),
        *texts("started", "ended", nullable=True),
        sa.Column("starts", sa.Integer(), nullable=False),
        *texts("fault", nullable=True),
        sa.UniqueConstraint("id", name="uq_jobs_id"),
        sa.UniqueConstraint("user", "idempotency_key", name="uq_jobs_key"),
    )
    op.create_index("ix_jobs_user", "jobs", ["user"])
    op.create_index("ix_jobs_session_id", "jobs", ["session_id"])
    op.create_index("ix_jobs_queue", "jobs", ["state", "number"])
    op.create_table(
        "calibrations",
        key(),
        reference("calibrations", "job_id", "jobs"),
        reference("calibrations", "session_id", "sessions"),
        *texts("rig_name", "created", "user"),
        sa.UniqueConstraint("job_id", name="uq_calibrations_job_id"),
    )
    op.create_index("ix_calibrations_session_id", "calibrations", ["session_id"])
    op.create_index("ix_calibrations_rig_name", "calibrations", ["rig_name"])
    op.create_table(
        "audit",
        number(),
        *texts("time", "user"),
        *texts("token_id", nullable=True),
        *texts("request_id", "action", "target"),
    )
    op.create_index("ix_audit_time", "audit", ["time"])
