"""The last number that a submap of each tenant was given: a query may ask for it after that submap was deleted."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table. Numbers of submaps that were deleted before are not known any more."""
    op.create_table(
        "last_submaps",
        sa.Column("tenant", sa.String(64), primary_key=True),
        sa.Column("number", sa.BigInteger(), nullable=False),
    )
    op.execute("INSERT INTO last_submaps (tenant, number) SELECT tenant, max(number) FROM submaps GROUP BY tenant")


def downgrade() -> None:
    """Drop it."""
    op.drop_table("last_submaps")
