"""Maps have plans: pictures that lie underneath them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0039"
down_revision = "0038"
branch_labels = None
depends_on = None

NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Add a table; everything that is there is kept."""
    op.create_table(
        "plans",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        *(sa.Column(name, sa.String(64), nullable=False) for name in ("tenant", "map_id", "plan_id", "content_hash")),
        sa.Column("display_name", sa.String(256), nullable=False),
        sa.Column("storey", sa.String(64), nullable=True),
        sa.Column("media_type", sa.String(16), nullable=False),
        *(sa.Column(name, sa.BigInteger, nullable=False) for name in ("width_px", "height_px", "size_bytes")),
        sa.Column("image_sha256", sa.String(64), nullable=False),
        sa.Column("frame", sa.String(32), nullable=False),
        sa.Column("pins", sa.JSON, nullable=False),
        sa.Column("created_at_ns", sa.BigInteger, nullable=False),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sa.ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"], name="fk_plans_maps_tenant_map_id"),
        sa.UniqueConstraint("tenant", "map_id", "plan_id", name="uq_plans_tenant_map_id_plan_id"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_plans_tenant_image_sha256", "plans", ["tenant", "image_sha256"])


def downgrade() -> None:
    """Drop it: the pictures are blobs that no row names."""
    op.drop_table("plans")
