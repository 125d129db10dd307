"""Queries that have ended, by when they did: their answers are forgotten after a while."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the index."""
    op.create_index("ix_jobs_finished_at_ns", "jobs", ["finished_at_ns"], sqlite_where=sa.text("priority = 0"))


def downgrade() -> None:
    """Drop the index."""
    op.drop_index("ix_jobs_finished_at_ns", "jobs")
