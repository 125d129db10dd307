"""Tiles of versions of maps that were made, and versions of maps as files."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the tables."""
    op.create_table(
        "map_tiles",
        sa.Column("number", sa.Integer(), primary_key=True, autoincrement=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("map_id", sa.String(64), nullable=False),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.Column("tile_id", sa.String(64), nullable=False),
        sa.Column("tile_sha256", sa.String(64), nullable=False),
        sa.Column("submaps", sa.BigInteger(), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"], name="fk_map_tiles_maps_tenant"),
        sa.UniqueConstraint("tenant", "map_id", "version", "tile_id", name="uq_map_tiles_tenant_map_id_version_tile_id"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_map_tiles_tenant_tile_sha256", "map_tiles", ["tenant", "tile_sha256"])
    op.create_table(
        "map_files",
        sa.Column("number", sa.Integer(), primary_key=True, autoincrement=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("map_id", sa.String(64), nullable=False),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("layout_sha256", sa.String(64), nullable=False),
        sa.Column("sessions", sa.JSON(), nullable=False),
        sa.Column("submaps", sa.BigInteger(), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("description", sa.Text(), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"], name="fk_map_files_maps_tenant"),
        sa.UniqueConstraint("tenant", "map_id", "version", name="uq_map_files_tenant_map_id_version"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_map_files_tenant_layout_sha256", "map_files", ["tenant", "layout_sha256"])


def downgrade() -> None:
    """Drop them: tiles are made again, files have to be published again."""
    op.drop_table("map_files")
    op.drop_table("map_tiles")
