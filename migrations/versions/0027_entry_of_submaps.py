"""A submap enters its map first, and its loops are searched for then."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0027"
down_revision = "0026"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns. Submaps that were described before this have entered before all others, and have their loops."""
    op.add_column("submaps", sa.Column("entered", sa.BigInteger, nullable=False, server_default="0"))
    op.add_column("submaps", sa.Column("map_version", sa.BigInteger, nullable=False, server_default="0"))
    op.add_column("submaps", sa.Column("searched", sa.Boolean, nullable=False, server_default="1"))
    unsearched = sa.text("NOT searched")
    rows = {"sqlite_where": unsearched, "postgresql_where": unsearched}
    op.create_index("ix_submaps_tenant_map_id", "submaps", ["tenant", "map_id"], **rows)


def downgrade() -> None:
    """Drop them. The older version describes a submap again of which the job has not ended."""
    op.drop_index("ix_submaps_tenant_map_id", "submaps")
    for name in ("searched", "map_version", "entered"):
        op.drop_column("submaps", name)
