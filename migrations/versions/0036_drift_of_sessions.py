"""Sessions may say how far their odometry drifts."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0036"
down_revision = "0035"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column: those that are there have said nothing."""
    op.add_column("sessions", sa.Column("drift", sa.String(64), nullable=True))


def downgrade() -> None:
    """Forget the statements: their odometry is one like others then."""
    op.drop_column("sessions", "drift")
