"""Sessions have anchors, versions of maps verdicts on them, and maps an origin on earth."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0035"
down_revision = "0034"
branch_labels = None
depends_on = None

NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Add a table and two columns; everything that is there is kept."""
    op.add_column("maps", sa.Column("origin", sa.JSON, nullable=True))
    op.add_column("map_versions", sa.Column("anchors", sa.LargeBinary, nullable=True))
    op.create_table(
        "anchors",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        *(sa.Column(name, sa.String(64), nullable=False) for name in ("tenant", "map_id", "session_id", "anchor_id")),
        sa.Column("content_hash", sa.String(64), nullable=False),
        *(sa.Column(name, sa.String(16), nullable=False) for name in ("kind", "frame")),
        sa.Column("stamp_ns", sa.BigInteger, nullable=False),
        *(sa.Column(name, sa.JSON, nullable=False) for name in ("position", "covariance", "offset_m")),
        sa.Column("T_odom_sensor", sa.LargeBinary, nullable=False),
        *(sa.Column(name, sa.Float, nullable=True) for name in ("heading_rad", "heading_sigma_rad")),
        sa.Column("created_at_ns", sa.BigInteger, nullable=False),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sa.ForeignKeyConstraint(
            ["tenant", "map_id", "session_id"],
            ["sessions.tenant", "sessions.map_id", "sessions.session_id"],
            name="fk_anchors_sessions_tenant_map_id_session_id",
        ),
        sa.UniqueConstraint(
            "tenant", "map_id", "session_id", "anchor_id", name="uq_anchors_tenant_map_id_session_id_anchor_id"
        ),
        sqlite_autoincrement=True,
    )


def downgrade() -> None:
    """Drop them: the poses of versions stay as the anchors have made them."""
    op.drop_table("anchors")
    op.drop_column("map_versions", "anchors")
    op.drop_column("maps", "origin")
