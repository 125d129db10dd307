"""A map's own rules for loop closures; null where it follows the service."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None

RULES = ("min_score", "min_overlap", "max_seen_through")


def upgrade() -> None:
    """Add the columns; maps that exist follow the service."""
    op.add_column("maps", sa.Column("loop_candidates", sa.BigInteger(), nullable=True))
    for name in RULES:
        op.add_column("maps", sa.Column(name, sa.Float(), nullable=True))


def downgrade() -> None:
    """Drop the columns. Loops of a map with rules of its own would be judged differently: there must be none."""
    ruled = " OR ".join(f"{name} IS NOT NULL" for name in ("loop_candidates", *RULES))
    count = op.get_bind().scalar(sa.text(f"SELECT count(*) FROM maps WHERE {ruled}"))
    if count:
        raise RuntimeError(f"{count} maps have a loop policy that the older schema cannot hold; delete them first")
    for name in (*reversed(RULES), "loop_candidates"):
        op.drop_column("maps", name)
