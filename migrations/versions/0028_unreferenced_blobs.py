"""Blobs that no row names any more wait in a table, by the clock of the store, which goes on from boot to boot."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0028"
down_revision = "0027"
branch_labels = None
depends_on = None

NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
"""Of rows, as in 0024."""


def upgrade() -> None:
    """Add the tables."""
    op.create_table(
        "unreferenced_blobs",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("kind", sa.String(32), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("since_ms", sa.BigInteger, nullable=False),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_unreferenced_blobs_tenant_sha256", "unreferenced_blobs", ["tenant", "sha256"])
    op.create_index("ix_unreferenced_blobs_state_since_ms", "unreferenced_blobs", ["state", "since_ms"])
    if op.get_bind().dialect.name == "postgresql":  # a server tells the time itself
        return
    op.create_table(
        "boots",
        sa.Column("boot_id", sa.String(64), nullable=False),
        sa.Column("offset_ms", sa.BigInteger, nullable=False),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sa.PrimaryKeyConstraint("boot_id", name="pk_boots"),
    )


def downgrade() -> None:
    """Drop them: the older version's sweep finds the files that no row names."""
    if op.get_bind().dialect.name != "postgresql":
        op.drop_table("boots")
    op.drop_table("unreferenced_blobs")
