"""Whose turn it is at the workers, when a run began, and how many runs do not count against their job."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add a table and two columns; all tenants begin at the same point."""
    op.create_table(
        "tenant_turns",
        sa.Column("tenant", sa.String(64), primary_key=True),
        sa.Column("started_ms", sa.BigInteger(), nullable=False),
        sa.Column("spent_ms", sa.BigInteger(), nullable=False),
    )
    for name in ("claimed_ms", "forgiven"):
        op.add_column("jobs", sa.Column(name, sa.BigInteger(), nullable=False, server_default="0"))


def downgrade() -> None:
    """Drop them. A job then has as many attempts less as were forgiven."""
    for name in ("forgiven", "claimed_ms"):
        op.drop_column("jobs", name)
    op.drop_table("tenant_turns")
