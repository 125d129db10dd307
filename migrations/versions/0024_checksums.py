"""A checksum in every row (see `adapters.sqlite.row_checksums`); the rows get theirs when all migrations are done.

The audit log has none: its rows have a chain of hashes, and no row of it may be changed.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"
branch_labels = None
depends_on = None

TABLES = (
    *("api_keys", "deletions", "early_corrections", "events", "index_changes", "jobs", "last_submaps"),
    *("loop_closures", "loop_events", "map_files", "map_merges", "map_tiles", "map_versions", "maps", "robots"),
    *("scans", "session_poses", "sessions", "submaps", "tenant_turns", "webhook_deliveries", "webhooks", "workers"),
)


def upgrade() -> None:
    """Add the column to each table."""
    for table in TABLES:
        op.add_column(table, sa.Column("checksum", sa.BigInteger(), nullable=True))


def downgrade() -> None:
    """Drop them: damage is seen less well."""
    for table in TABLES:
        op.drop_column(table, "checksum")
