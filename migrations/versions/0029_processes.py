"""Gateways and search processes show themselves in a table."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0029"
down_revision = "0028"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "processes",
        sa.Column("process_id", sa.String(64), primary_key=True),
        sa.Column("role", sa.String(16), nullable=False),
        sa.Column("address", sa.String(255), nullable=False),
        sa.Column("ready", sa.Boolean, nullable=False),
        sa.Column("busy", sa.JSON, nullable=False),
        sa.Column("came_ms", sa.BigInteger, nullable=False),
        sa.Column("seen_ms", sa.BigInteger, nullable=False),
    )


def downgrade() -> None:
    """Drop it: the older version searches in each process, and has one gateway."""
    op.drop_table("processes")
