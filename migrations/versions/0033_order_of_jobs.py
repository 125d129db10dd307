"""The next job of a tenant is the first entry of an index: PostgreSQL's hold no row number by themselves."""

from __future__ import annotations

from alembic import op

revision = "0033"
down_revision = "0032"
branch_labels = None
depends_on = None
runs_from = "0032"

FORMER, NAME = "ix_jobs_state_tenant_priority", "ix_jobs_state_tenant_priority_number"


def upgrade() -> None:
    """Exchange the index."""
    op.create_index(NAME, "jobs", ["state", "tenant", "priority", "number"])
    op.drop_index(FORMER, "jobs")


def downgrade() -> None:
    """Exchange it back."""
    op.create_index(FORMER, "jobs", ["state", "tenant", "priority"])
    op.drop_index(NAME, "jobs")
