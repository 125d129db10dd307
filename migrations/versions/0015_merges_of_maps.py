"""Merges of maps, how far a job has come, and whether somebody wants it to end."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table and the columns."""
    op.create_table(
        "map_merges",
        sa.Column("number", sa.Integer(), primary_key=True, autoincrement=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("map_id", sa.String(64), nullable=False),
        sa.Column("merge_id", sa.String(64), nullable=False),
        sa.Column("source", sa.String(300), nullable=False),
        sa.Column("version_before", sa.BigInteger(), nullable=False),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.Column("sessions", sa.JSON(), nullable=False),
        sa.Column("report", sa.JSON(), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.Column("reverted_at_ns", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"], name="fk_map_merges_maps_tenant"),
        sa.UniqueConstraint("tenant", "map_id", "merge_id", name="uq_map_merges_tenant_map_id_merge_id"),
        sqlite_autoincrement=True,
    )
    op.add_column("jobs", sa.Column("progress", sa.JSON(), nullable=True))
    op.add_column("jobs", sa.Column("cancel_requested", sa.Boolean(), nullable=False, server_default="0"))


def downgrade() -> None:
    """Drop them: what was merged stays merged, but cannot be taken apart any more."""
    op.drop_column("jobs", "cancel_requested")
    op.drop_column("jobs", "progress")
    op.drop_table("map_merges")
