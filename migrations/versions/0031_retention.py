"""Maps have a policy of retention; submaps say which scans are kept, and when they were described."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from alembic.util import CommandError

revision = "0031"
down_revision = "0030"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add columns; everything that is there is kept."""
    op.add_column("maps", sa.Column("retention", sa.String(256), nullable=True))
    op.add_column("maps", sa.Column("retention_run", sa.JSON, nullable=True))
    op.add_column("scans", sa.Column("chosen", sa.Boolean, nullable=False, server_default="0"))
    op.add_column("submaps", sa.Column("described_at_ns", sa.BigInteger, nullable=True))
    op.add_column("submaps", sa.Column("kept_scans", sa.String(16), nullable=False, server_default="ALL"))
    op.create_index("ix_submaps_tenant_map_id_kept_scans", "submaps", ["tenant", "map_id", "kept_scans"])


def downgrade() -> None:
    """Drop them; the version before does not know a retired submap."""
    found = op.get_bind().execute(sa.text("SELECT count(*) FROM submaps WHERE state = 'RETIRED'")).scalar_one()
    if found:
        raise CommandError(f"{found} submaps are retired, which the older version does not know")
    op.drop_index("ix_submaps_tenant_map_id_kept_scans", "submaps")
    op.drop_column("scans", "chosen")
    for table, columns in (("submaps", ("kept_scans", "described_at_ns")), ("maps", ("retention_run", "retention"))):
        for column in columns:
            op.drop_column(table, column)
