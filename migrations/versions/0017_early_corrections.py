"""Corrections of sessions by single loops, ahead of the next version of their map."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table."""
    op.create_table(
        "early_corrections",
        sa.Column("number", sa.Integer(), primary_key=True, autoincrement=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("map_id", sa.String(64), nullable=False),
        sa.Column("session_id", sa.String(64), nullable=False),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.Column("loops", sa.BigInteger(), nullable=False),
        sa.Column("T_map_odom", sa.JSON(), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["tenant", "map_id", "session_id"],
            ["sessions.tenant", "sessions.map_id", "sessions.session_id"],
            name="fk_early_corrections_sessions_tenant",
        ),
        sa.UniqueConstraint("tenant", "map_id", "session_id", name="uq_early_corrections_tenant_map_id_session_id"),
        sqlite_autoincrement=True,
    )


def downgrade() -> None:
    """Drop it: the next version of each map says more."""
    op.drop_table("early_corrections")
