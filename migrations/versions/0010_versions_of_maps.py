"""Versions of a map's poses, verdicts of its pose graph on loops, and the events of loops."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None

FIRST_EVENTS = """
INSERT INTO loop_events (tenant, map_id, loop_id, kind, state, reason, graph_state, "T_match_query", actor, note,
  map_version, details, query_number, match_number, query_session_id, match_session_id, at_ns)
SELECT tenant, map_id, loop_id, 'VERIFIED', state, reason, NULL, "T_match_query", 'service', '',
  0, '{}', query_number, match_number, query_session_id, match_session_id, created_at_ns
FROM loop_closures ORDER BY number
"""
"""The verdict of every loop that there is."""


def upgrade() -> None:
    """Add three tables and four columns; no map has a version yet."""
    for name in ("map_version", "graph_edits"):
        op.add_column("maps", sa.Column(name, sa.BigInteger(), nullable=False, server_default="0"))
    op.add_column("loop_closures", sa.Column("graph_state", sa.String(16), nullable=True))
    op.add_column("loop_closures", sa.Column("manual", sa.Boolean(), nullable=False, server_default="0"))
    _create_loop_events()
    _create_map_versions()
    _create_session_poses()
    op.execute(FIRST_EVENTS)


def downgrade() -> None:
    """Drop them with all versions of maps. Loops that a person decided on would lose who and why: there must be none."""
    decided = op.get_bind().scalar(sa.text("SELECT count(*) FROM loop_events WHERE kind NOT IN ('VERIFIED', 'JUDGED')"))
    if decided:
        raise RuntimeError(f"people have decided on loops {decided} times, which the older schema cannot hold")
    for table in ("session_poses", "map_versions", "loop_events"):
        op.drop_table(table)
    for name in ("manual", "graph_state"):
        op.drop_column("loop_closures", name)
    for name in ("graph_edits", "map_version"):
        op.drop_column("maps", name)


def _create_loop_events() -> None:
    op.create_table(
        "loop_events",
        *_number_and_map(),
        sa.Column("loop_id", sa.String(64), nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("reason", sa.String(64), nullable=True),
        sa.Column("graph_state", sa.String(16), nullable=True),
        sa.Column("T_match_query", sa.JSON(), nullable=True),
        sa.Column("actor", sa.String(128), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("map_version", sa.BigInteger(), nullable=False),
        sa.Column("details", sa.JSON(), nullable=False),
        sa.Column("query_number", sa.Integer(), nullable=False),
        sa.Column("match_number", sa.Integer(), nullable=False),
        sa.Column("query_session_id", sa.String(64), nullable=False),
        sa.Column("match_session_id", sa.String(64), nullable=False),
        sa.Column("at_ns", sa.BigInteger(), nullable=False),
        sa.UniqueConstraint("tenant", "number", name="uq_loop_events_tenant_number"),
        _of_map("loop_events"),
        sa.PrimaryKeyConstraint("number", name="pk_loop_events"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_loop_events_tenant_map_id_loop_id", "loop_events", ["tenant", "map_id", "loop_id"])
    for end in ("query_number", "match_number"):
        op.create_index(f"ix_loop_events_{end}", "loop_events", [end])


def _create_map_versions() -> None:
    op.create_table(
        "map_versions",
        *_number_and_map(),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.Column("restored_from", sa.BigInteger(), nullable=True),
        sa.Column("operation_id", sa.String(64), nullable=True),
        sa.Column("summary", sa.JSON(), nullable=False),
        sa.Column("loops", sa.LargeBinary(), nullable=False),
        sa.Column("loops_hash", sa.String(64), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.UniqueConstraint("tenant", "map_id", "version", name="uq_map_versions_tenant_map_id_version"),
        _of_map("map_versions"),
        sa.PrimaryKeyConstraint("number", name="pk_map_versions"),
        sqlite_autoincrement=True,
    )


def _create_session_poses() -> None:
    op.create_table(
        "session_poses",
        *_number_and_map(),
        sa.Column("version", sa.BigInteger(), nullable=False),
        sa.Column("session_id", sa.String(64), nullable=False),
        sa.Column("session_number", sa.BigInteger(), nullable=False),
        sa.Column("frame", sa.String(64), nullable=False),
        sa.Column("T_map_odom", sa.JSON(), nullable=False),
        sa.Column("submaps", sa.LargeBinary(), nullable=False),
        sa.Column("content_hash", sa.String(64), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.UniqueConstraint(
            "tenant", "map_id", "version", "session_id", name="uq_session_poses_tenant_map_id_version_session_id"
        ),
        sa.ForeignKeyConstraint(
            ["tenant", "map_id", "session_id"],
            ["sessions.tenant", "sessions.map_id", "sessions.session_id"],
            name="fk_session_poses_sessions_tenant_map_id_session_id",
        ),
        sa.ForeignKeyConstraint(
            ["tenant", "map_id", "version"],
            ["map_versions.tenant", "map_versions.map_id", "map_versions.version"],
            name="fk_session_poses_map_versions_tenant_map_id_version",
        ),
        sa.PrimaryKeyConstraint("number", name="pk_session_poses"),
        sqlite_autoincrement=True,
    )
    name = "ix_session_poses_tenant_map_id_session_id"
    op.create_index(name, "session_poses", ["tenant", "map_id", "session_id"])


def _number_and_map() -> tuple[sa.Column[int], sa.Column[str], sa.Column[str]]:
    return (
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("tenant", sa.String(64), nullable=False),
        sa.Column("map_id", sa.String(64), nullable=False),
    )


def _of_map(table: str) -> sa.ForeignKeyConstraint:
    name = f"fk_{table}_maps_tenant_map_id"
    return sa.ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"], name=name)
