"""Meshes are made when they are asked for: no submap names one any more."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Drop the names of the stored meshes: no row names them then, and the next sweep deletes them."""
    op.drop_index("ix_submaps_tenant_mesh_sha256", "submaps")
    op.drop_column("submaps", "mesh_sha256")


def downgrade() -> None:
    """Add the column again, empty: the older version answers that the meshes of these submaps are lost."""
    op.add_column("submaps", sa.Column("mesh_sha256", sa.String(64), nullable=True))
    op.create_index("ix_submaps_tenant_mesh_sha256", "submaps", ["tenant", "mesh_sha256"])
