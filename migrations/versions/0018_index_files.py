"""The file that the index of a map may be loaded from."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add its name to the maps: none has one yet."""
    op.add_column("maps", sa.Column("index_file", sa.String(128), nullable=True))


def downgrade() -> None:
    """Drop it: an index is loaded from the database then."""
    op.drop_column("maps", "index_file")
