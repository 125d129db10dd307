"""A session knows the stream that stored its last scan, so that the newest one holds over several gateways."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0026"
down_revision = "0025"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column: no stream has stored a scan since."""
    op.add_column("sessions", sa.Column("stream", sa.String(32), nullable=True))


def downgrade() -> None:
    """Drop it."""
    op.drop_column("sessions", "stream")
