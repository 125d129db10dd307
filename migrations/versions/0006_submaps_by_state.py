"""Submaps by state: what waits in a map, and how many a tenant has, without reading their descriptors."""

from __future__ import annotations

from alembic import op

revision = "0006"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the index."""
    op.create_index("ix_submaps_state_tenant_map_id", "submaps", ["state", "tenant", "map_id"])


def downgrade() -> None:
    """Drop the index."""
    op.drop_index("ix_submaps_state_tenant_map_id", "submaps")
