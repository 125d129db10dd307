"""The storey of a session, where a client has said it."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add it to the sessions: of those that exist nobody has said it."""
    op.add_column("sessions", sa.Column("storey", sa.String(64), nullable=True))
    op.create_index("ix_sessions_tenant_map_id_storey", "sessions", ["tenant", "map_id", "storey"])


def downgrade() -> None:
    """Drop it. Sessions on different storeys would be compared with each other: there must be none with one."""
    count = op.get_bind().scalar(sa.text("SELECT count(*) FROM sessions WHERE storey IS NOT NULL"))
    if count:
        raise RuntimeError(f"{count} sessions have a storey that the older schema cannot hold; delete them first")
    op.drop_index("ix_sessions_tenant_map_id_storey", "sessions")
    op.drop_column("sessions", "storey")
