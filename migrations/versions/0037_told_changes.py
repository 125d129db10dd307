"""Sessions keep what was told of the changes that their drives found."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0037"
down_revision = "0036"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column: of those that are there nothing was told."""
    op.add_column("sessions", sa.Column("changes_told", sa.String(64), nullable=True))


def downgrade() -> None:
    """Forget it: the events that tell of it are gone then."""
    op.drop_column("sessions", "changes_told")
