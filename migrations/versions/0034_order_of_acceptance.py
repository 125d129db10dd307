"""Loops have a number from the event that accepted them: a watch rests on it.

The numbers that were given out stay: clients hold them. The events of a map go on behind the highest of its loops.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0034"
down_revision = "0033"
branch_labels = None
depends_on = None

OF_MAP = "loop_closures.tenant = map_counters.tenant AND loop_closures.map_id = map_counters.map_id"
EVENTS_GO_ON = f"""UPDATE map_counters SET events = (SELECT max(number) FROM loop_closures WHERE {OF_MAP})
WHERE events < (SELECT max(number) FROM loop_closures WHERE {OF_MAP})"""


def upgrade() -> None:
    """Add the column and its index; the rows that are there keep their numbers."""
    op.add_column("loop_closures", sa.Column("seq", sa.BigInteger, nullable=False, server_default="0"))
    op.execute("UPDATE loop_closures SET seq = number")
    op.execute(EVENTS_GO_ON)
    accepted = sa.text("state = 'ACCEPTED'")
    rows = {"sqlite_where": accepted, "postgresql_where": accepted}
    op.create_index("ix_loop_closures_tenant_map_id_seq", "loop_closures", ["tenant", "map_id", "seq"], **rows)


def downgrade() -> None:
    """Number by rows again: what a client has seen may be told once more."""
    op.drop_index("ix_loop_closures_tenant_map_id_seq", "loop_closures")
    op.drop_column("loop_closures", "seq")
