"""The gap within a drive is a distance, no number of submaps; the submaps of a drive are found in their order."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None

_METRES_A_SUBMAP = "0.02 * coalesce(stride_m, 5.0)"
"""A loop is sought everywhere after the way that the gap was: the distance is 0.02 of that (docs/decisions/0316)."""


def upgrade() -> None:
    """A map with a gap of its own gets the distance that comes to the same way."""
    op.add_column("maps", sa.Column("leave_distance_m", sa.Float(), nullable=True))
    op.execute(f"UPDATE maps SET leave_distance_m = min_index_gap * {_METRES_A_SUBMAP}")
    op.drop_column("maps", "min_index_gap")
    op.create_index(
        "ix_submaps_tenant_map_id_session_id_ordinal", "submaps", ["tenant", "map_id", "session_id", "ordinal"]
    )


def downgrade() -> None:
    """The nearest gap."""
    op.drop_index("ix_submaps_tenant_map_id_session_id_ordinal", "submaps")
    op.add_column("maps", sa.Column("min_index_gap", sa.BigInteger(), nullable=True))
    op.execute(f"UPDATE maps SET min_index_gap = CAST(round(leave_distance_m / ({_METRES_A_SUBMAP})) AS BIGINT)")
    op.drop_column("maps", "leave_distance_m")
