"""Jobs by tenant, so that workers can take one tenant's after another's."""

from __future__ import annotations

from alembic import op

revision = "0004"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Order the waiting jobs by tenant first."""
    op.drop_index("ix_jobs_state_priority", "jobs")
    op.create_index("ix_jobs_state_tenant_priority", "jobs", ["state", "tenant", "priority"])


def downgrade() -> None:
    """Order them by urgency first."""
    op.drop_index("ix_jobs_state_tenant_priority", "jobs")
    op.create_index("ix_jobs_state_priority", "jobs", ["state", "priority"])
