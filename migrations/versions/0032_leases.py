"""Leases by the store's clock with random ids; turns of tenants as a row for each of their workers."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0032"
down_revision = "0031"
branch_labels = None
depends_on = None

RUNS_END = """UPDATE jobs SET state = 'QUEUED', forgiven = forgiven + 1, lease_expires_ms = 0, claimed_ms = 0
WHERE state = 'RUNNING'"""
NOTHING_IS_LATER = "UPDATE jobs SET not_before_ms = 0, claimed_ms = 0 WHERE not_before_ms <> 0 OR claimed_ms <> 0"
"""Times are of another clock from now on: who has left the queue comes back to it, who waits for a time is due."""


def upgrade() -> None:
    """Change the columns; nobody runs a job meanwhile."""
    _begin_anew()
    op.add_column("jobs", sa.Column("lease_id", sa.String(32), nullable=False, server_default=""))
    op.drop_column("jobs", "lease_epoch")
    op.drop_column("jobs", "lease_token")
    op.drop_column("workers", "epoch")
    op.create_table(
        "worker_turns",
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("worker_id", sa.String(64), nullable=False),
        sa.Column("started_ms", sa.BigInteger, nullable=False),
        sa.Column("ran_ms", sa.BigInteger, nullable=False),
        sa.Column("lifted_ms", sa.BigInteger, nullable=False),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sa.PrimaryKeyConstraint("tenant", "worker_id", name="pk_worker_turns"),
    )
    op.create_index("ix_worker_turns_started_ms", "worker_turns", ["started_ms"])
    op.execute(
        "INSERT INTO worker_turns (tenant, worker_id, started_ms, ran_ms, lifted_ms) "
        "SELECT tenant, '', started_ms, spent_ms, 0 FROM tenant_turns"
    )
    op.drop_table("tenant_turns")


def downgrade() -> None:
    """Back; each tenant's rows are one."""
    _begin_anew()
    op.create_table(
        "tenant_turns",
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("started_ms", sa.BigInteger, nullable=False),
        sa.Column("spent_ms", sa.BigInteger, nullable=False),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sa.PrimaryKeyConstraint("tenant", name="pk_tenant_turns"),
    )
    op.execute(
        "INSERT INTO tenant_turns (tenant, started_ms, spent_ms) "
        "SELECT tenant, max(started_ms), sum(ran_ms) + max(lifted_ms) FROM worker_turns GROUP BY tenant"
    )
    op.drop_table("worker_turns")
    op.drop_table("workers")
    op.create_table(
        "workers",
        sa.Column("worker_id", sa.String(64), nullable=False),
        sa.Column("model_version", sa.String(128), nullable=False),
        sa.Column("epoch", sa.String(64), nullable=False),
        sa.Column("seen_ms", sa.BigInteger, nullable=False),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sa.PrimaryKeyConstraint("worker_id", name="pk_workers"),
    )
    _without_lease_id()


def _without_lease_id() -> None:
    """The columns of jobs as they were: in their order, where the engine copies the table anyway."""
    copied = op.get_bind().dialect.name == "sqlite"
    table = {"recreate": "always", "table_kwargs": {"sqlite_autoincrement": True}} if copied else {}
    before = {"lease_token": sa.BigInteger(), "lease_epoch": sa.String(64)}
    with op.batch_alter_table("jobs", **table) as jobs:
        for (name, kind), after in zip(before.items(), ("lease_owner", "lease_token"), strict=True):
            place = {"insert_after": after} if copied else {}
            jobs.add_column(sa.Column(name, kind, nullable=False, server_default="0"), **place)
        jobs.drop_column("lease_id")
    with op.batch_alter_table("jobs", **table) as jobs:
        for name, kind in before.items():
            jobs.alter_column(name, existing_type=kind, server_default=None)


def _begin_anew() -> None:
    for statement in (RUNS_END, NOTHING_IS_LATER, "DELETE FROM workers"):
        op.execute(statement)
