"""Changes, events and submaps are numbered within their map, by one row of counters for each.

The numbers that were given out stay: clients hold them. A map goes on behind the highest of all maps.
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0030"
down_revision = "0029"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add counters and positions; the rows that are there keep their numbers."""
    _table("map_counters", ("tenant", "map_id"), "changes", "events", "submaps", "forgotten")
    op.create_table(
        "webhook_positions",
        sa.Column("webhook_number", sa.BigInteger, nullable=False),
        sa.Column("map_id", sa.String(64), nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("told", sa.BigInteger, nullable=False),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sa.PrimaryKeyConstraint("webhook_number", "map_id", name="pk_webhook_positions"),
    )
    op.create_index("ix_webhook_positions_tenant_map_id", "webhook_positions", ["tenant", "map_id"])
    op.drop_index("ix_index_changes_tenant_map_number_seq", "index_changes")
    op.execute("ALTER TABLE index_changes RENAME COLUMN seq TO number")
    for table in ("index_changes", "events", "submaps"):
        op.add_column(table, sa.Column("seq", sa.BigInteger, nullable=False, server_default="0"))
        op.execute(f"UPDATE {table} SET seq = number")
    op.create_index("ix_index_changes_tenant_map_number_seq", "index_changes", ["tenant", "map_number", "seq"])
    op.drop_index("ix_events_tenant_number", "events")
    op.create_index("ix_events_tenant_map_id_seq", "events", ["tenant", "map_id", "seq"])
    op.execute(
        "INSERT INTO map_counters (tenant, map_id, changes, events, submaps, forgotten) SELECT maps.tenant, maps.map_id, "
        "coalesce((SELECT max(seq) FROM index_changes WHERE map_number = maps.number), 0), "
        "coalesce((SELECT max(seq) FROM events), 0), "
        "coalesce((SELECT number FROM last_submaps WHERE tenant = maps.tenant), 0), "
        "coalesce((SELECT max(seq) FROM events WHERE tenant = maps.tenant AND kind = 'FORGOTTEN'), 0) FROM maps"
    )
    op.execute("DELETE FROM events WHERE kind = 'FORGOTTEN'")
    op.execute(
        "INSERT INTO webhook_positions (webhook_number, map_id, tenant, told) "
        "SELECT webhooks.number, maps.map_id, maps.tenant, webhooks.told FROM webhooks "
        "JOIN maps ON maps.tenant = webhooks.tenant AND coalesce(webhooks.map_id, maps.map_id) = maps.map_id"
    )
    op.drop_table("last_submaps")


def downgrade() -> None:
    """Number by rows again, which are at least as high: what a client has seen may be told once more."""
    _table("last_submaps", ("tenant",), "number")
    op.execute("INSERT INTO last_submaps (tenant, number) SELECT tenant, max(number) FROM submaps GROUP BY tenant")
    op.drop_index("ix_events_tenant_map_id_seq", "events")
    op.create_index("ix_events_tenant_number", "events", ["tenant", "number"])
    op.drop_index("ix_index_changes_tenant_map_number_seq", "index_changes")
    for table in ("submaps", "events", "index_changes"):
        op.drop_column(table, "seq")
    op.execute("ALTER TABLE index_changes RENAME COLUMN number TO seq")
    op.create_index("ix_index_changes_tenant_map_number_seq", "index_changes", ["tenant", "map_number", "seq"])
    op.drop_table("webhook_positions")
    op.drop_table("map_counters")


def _table(name: str, key: tuple[str, ...], *numbers: str) -> None:
    op.create_table(
        name,
        *(sa.Column(column, sa.String(64), nullable=False) for column in key),
        *(sa.Column(column, sa.BigInteger, nullable=False) for column in numbers),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sa.PrimaryKeyConstraint(*key, name=f"pk_{name}"),
    )
