"""What is being deleted, portion by portion."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the table: nothing is being deleted."""
    op.create_table(
        "deletions",
        sa.Column("number", sa.Integer(), primary_key=True, autoincrement=True),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("map_id", sa.String(64), nullable=False),
        sa.Column("session_id", sa.String(64), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.UniqueConstraint("tenant", "map_id", "session_id", name="uq_deletions_tenant_map_id_session_id"),
        sqlite_autoincrement=True,
    )


def downgrade() -> None:
    """Drop it. What was being deleted would be back, in part: there must be nothing."""
    count = op.get_bind().scalar(sa.text("SELECT count(*) FROM deletions"))
    if count:
        raise RuntimeError(f"{count} sessions or maps are being deleted; let the service finish, then try again")
    # The older version knows no change of a whole session: it loads every index anew, from the rows that are there.
    op.execute(sa.text("DELETE FROM index_changes WHERE kind = 'SESSION_REMOVED'"))
    op.execute(sa.text("UPDATE maps SET index_file = NULL"))
    op.drop_table("deletions")
