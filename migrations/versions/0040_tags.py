"""Anchors may be fiducials of unknown place, which have the id of a tag."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0040"
down_revision = "0039"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column: those that are there have none."""
    op.add_column("anchors", sa.Column("tag", sa.String(64), nullable=True))


def downgrade() -> None:
    """Forget the fiducials: without the id of their tag they say nothing."""
    op.execute("DELETE FROM anchors WHERE kind = 'FIDUCIAL'")
    op.drop_column("anchors", "tag")
