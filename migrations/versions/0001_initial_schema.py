"""Initial schema: maps, robots, sessions, scans, submaps, loop closures, jobs, the index's change log, workers."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

TABLES = ("maps", "robots", "sessions", "scans", "submaps", "loop_closures", "jobs", "index_changes", "workers")
"""Parents first."""


def upgrade() -> None:
    """Create every table with its indexes."""
    _create_maps()
    _create_robots()
    _create_sessions()
    _create_scans()
    _create_submaps()
    _create_loop_closures()
    _create_jobs()
    _create_index_changes()
    _create_workers()


def downgrade() -> None:
    """Drop every table, children first; their indexes go with them."""
    for table in reversed(TABLES):
        op.drop_table(table)


def _create_maps() -> None:
    op.create_table(
        "maps",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("tenant", sa.String(length=64), nullable=False),
        sa.Column("map_id", sa.String(length=64), nullable=False),
        sa.Column("content_hash", sa.String(length=64), nullable=False),
        sa.Column("display_name", sa.String(length=256), nullable=False),
        sa.Column("tau_m", sa.Float(), nullable=True),
        sa.Column("stride_m", sa.Float(), nullable=True),
        sa.Column("min_index_gap", sa.BigInteger(), nullable=True),
        sa.Column("model_version", sa.String(length=128), nullable=True),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_maps"),
        sa.UniqueConstraint("tenant", "map_id", name="uq_maps_tenant_map_id"),
        sqlite_autoincrement=True,
    )


def _create_robots() -> None:
    op.create_table(
        "robots",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("tenant", sa.String(length=64), nullable=False),
        sa.Column("robot_id", sa.String(length=64), nullable=False),
        sa.Column("content_hash", sa.String(length=64), nullable=False),
        sa.Column("display_name", sa.String(length=256), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_robots"),
        sa.UniqueConstraint("tenant", "robot_id", name="uq_robots_tenant_robot_id"),
        sqlite_autoincrement=True,
    )


def _create_sessions() -> None:
    op.create_table(
        "sessions",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("tenant", sa.String(length=64), nullable=False),
        sa.Column("map_id", sa.String(length=64), nullable=False),
        sa.Column("session_id", sa.String(length=64), nullable=False),
        sa.Column("content_hash", sa.String(length=64), nullable=False),
        sa.Column("robot_id", sa.String(length=64), nullable=True),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("committed_seq", sa.BigInteger(), nullable=False),
        sa.Column("next_ordinal", sa.BigInteger(), nullable=False),
        sa.Column("travelled_m", sa.Float(), nullable=False),
        sa.Column("window_start_m", sa.Float(), nullable=False),
        sa.Column("window_first_seq", sa.BigInteger(), nullable=False),
        sa.Column("emitted_to_m", sa.Float(), nullable=True),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.Column("finished_at_ns", sa.BigInteger(), nullable=True),
        sa.ForeignKeyConstraint(
            ["tenant", "map_id"],
            ["maps.tenant", "maps.map_id"],
            name="fk_sessions_maps_tenant_map_id",
        ),
        sa.ForeignKeyConstraint(
            ["tenant", "robot_id"],
            ["robots.tenant", "robots.robot_id"],
            name="fk_sessions_robots_tenant_robot_id",
        ),
        sa.PrimaryKeyConstraint("number", name="pk_sessions"),
        sa.UniqueConstraint("tenant", "map_id", "session_id", name="uq_sessions_tenant_map_id_session_id"),
        sqlite_autoincrement=True,
    )


def _create_scans() -> None:
    op.create_table(
        "scans",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("tenant", sa.String(length=64), nullable=False),
        sa.Column("map_id", sa.String(length=64), nullable=False),
        sa.Column("session_id", sa.String(length=64), nullable=False),
        sa.Column("seq", sa.BigInteger(), nullable=False),
        sa.Column("stamp_ns", sa.BigInteger(), nullable=False),
        sa.Column("T_odom_sensor", sa.JSON(), nullable=False),
        sa.Column("travelled_m", sa.Float(), nullable=False),
        sa.Column("point_count", sa.BigInteger(), nullable=False),
        sa.Column("cloud_sha256", sa.String(length=64), nullable=False),
        sa.ForeignKeyConstraint(
            ["tenant", "map_id", "session_id"],
            ["sessions.tenant", "sessions.map_id", "sessions.session_id"],
            name="fk_scans_sessions_tenant_map_id_session_id",
        ),
        sa.PrimaryKeyConstraint("number", name="pk_scans"),
        sa.UniqueConstraint("tenant", "map_id", "session_id", "seq", name="uq_scans_tenant_map_id_session_id_seq"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_scans_tenant_cloud_sha256", "scans", ["tenant", "cloud_sha256"])
    op.create_index("ix_scans_tenant_map_id_session_id_travelled_m", "scans", ["tenant", "map_id", "session_id", "travelled_m"])


def _create_submaps() -> None:
    op.create_table(
        "submaps",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("tenant", sa.String(length=64), nullable=False),
        sa.Column("map_id", sa.String(length=64), nullable=False),
        sa.Column("session_id", sa.String(length=64), nullable=False),
        sa.Column("submap_id", sa.String(length=64), nullable=False),
        sa.Column("content_hash", sa.String(length=64), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("ordinal", sa.BigInteger(), nullable=False),
        sa.Column("session_number", sa.BigInteger(), nullable=False),
        sa.Column("T_odom_submap", sa.JSON(), nullable=False),
        sa.Column("position_m", sa.JSON(), nullable=False),
        sa.Column("stamp_ns", sa.BigInteger(), nullable=False),
        sa.Column("cloud_sha256", sa.String(length=64), nullable=True),
        sa.Column("first_seq", sa.BigInteger(), nullable=True),
        sa.Column("last_seq", sa.BigInteger(), nullable=True),
        sa.Column("scan_count", sa.BigInteger(), nullable=False),
        sa.Column("point_count", sa.BigInteger(), nullable=False),
        sa.Column("operation_id", sa.String(length=64), nullable=False),
        sa.Column("flags", sa.JSON(), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.Column("model_version", sa.String(length=128), nullable=True),
        sa.Column("descriptor", sa.LargeBinary(), nullable=True),
        sa.Column("signature_sha256", sa.String(length=64), nullable=True),
        sa.Column("neural_map_sha256", sa.String(length=64), nullable=True),
        sa.Column("neural_map_bytes", sa.BigInteger(), nullable=True),
        sa.Column("mesh_sha256", sa.String(length=64), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_message", sa.Text(), nullable=True),
        sa.ForeignKeyConstraint(
            ["tenant", "map_id", "session_id"],
            ["sessions.tenant", "sessions.map_id", "sessions.session_id"],
            name="fk_submaps_sessions_tenant_map_id_session_id",
        ),
        sa.PrimaryKeyConstraint("number", name="pk_submaps"),
        sa.UniqueConstraint(
            "tenant", "map_id", "session_id", "submap_id",
            name="uq_submaps_tenant_map_id_session_id_submap_id",
        ),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_submaps_tenant_cloud_sha256", "submaps", ["tenant", "cloud_sha256"])
    op.create_index("ix_submaps_tenant_mesh_sha256", "submaps", ["tenant", "mesh_sha256"])
    op.create_index("ix_submaps_tenant_neural_map_sha256", "submaps", ["tenant", "neural_map_sha256"])
    op.create_index("ix_submaps_tenant_signature_sha256", "submaps", ["tenant", "signature_sha256"])


def _create_loop_closures() -> None:
    op.create_table(
        "loop_closures",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("tenant", sa.String(length=64), nullable=False),
        sa.Column("map_id", sa.String(length=64), nullable=False),
        sa.Column("loop_id", sa.String(length=64), nullable=False),
        sa.Column("query_number", sa.Integer(), nullable=False),
        sa.Column("match_number", sa.Integer(), nullable=False),
        sa.Column("query_session_id", sa.String(length=64), nullable=False),
        sa.Column("query_submap_id", sa.String(length=64), nullable=False),
        sa.Column("match_session_id", sa.String(length=64), nullable=False),
        sa.Column("match_submap_id", sa.String(length=64), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.String(length=64), nullable=True),
        sa.Column("similarity", sa.Float(), nullable=False),
        sa.Column("score", sa.Float(), nullable=False),
        sa.Column("T_match_query", sa.JSON(), nullable=True),
        sa.Column("evidence", sa.JSON(), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(["match_number"], ["submaps.number"], name="fk_loop_closures_submaps_match_number"),
        sa.ForeignKeyConstraint(["query_number"], ["submaps.number"], name="fk_loop_closures_submaps_query_number"),
        sa.ForeignKeyConstraint(
            ["tenant", "map_id"],
            ["maps.tenant", "maps.map_id"],
            name="fk_loop_closures_maps_tenant_map_id",
        ),
        sa.PrimaryKeyConstraint("number", name="pk_loop_closures"),
        sa.UniqueConstraint("tenant", "map_id", "loop_id", name="uq_loop_closures_tenant_map_id_loop_id"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_loop_closures_match_number", "loop_closures", ["match_number"])
    op.create_index("ix_loop_closures_query_number", "loop_closures", ["query_number"])
    op.create_index("ix_loop_closures_tenant_map_id_state", "loop_closures", ["tenant", "map_id", "state"])


def _create_jobs() -> None:
    op.create_table(
        "jobs",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("tenant", sa.String(length=64), nullable=False),
        sa.Column("operation_id", sa.String(length=64), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("subject", sa.String(length=256), nullable=False),
        sa.Column("payload", sa.JSON(), nullable=False),
        sa.Column("attempts", sa.BigInteger(), nullable=False),
        sa.Column("max_attempts", sa.BigInteger(), nullable=False),
        sa.Column("created_at_ns", sa.BigInteger(), nullable=False),
        sa.Column("priority", sa.BigInteger(), nullable=False),
        sa.Column("lease_owner", sa.String(length=64), nullable=True),
        sa.Column("lease_token", sa.BigInteger(), nullable=False),
        sa.Column("lease_epoch", sa.String(length=64), nullable=False),
        sa.Column("not_before_ms", sa.BigInteger(), nullable=False),
        sa.Column("lease_expires_ms", sa.BigInteger(), nullable=False),
        sa.Column("result", sa.JSON(), nullable=True),
        sa.Column("failure_code", sa.String(length=64), nullable=True),
        sa.Column("failure_message", sa.Text(), nullable=True),
        sa.Column("finished_at_ns", sa.BigInteger(), nullable=True),
        sa.PrimaryKeyConstraint("number", name="pk_jobs"),
        sa.UniqueConstraint("tenant", "operation_id", name="uq_jobs_tenant_operation_id"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_jobs_state_priority", "jobs", ["state", "priority"])
    op.create_index("ix_jobs_tenant_state", "jobs", ["tenant", "state"])


def _create_index_changes() -> None:
    op.create_table(
        "index_changes",
        sa.Column("seq", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("tenant", sa.String(length=64), nullable=False),
        sa.Column("map_number", sa.Integer(), nullable=False),
        sa.Column("submap_number", sa.Integer(), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.PrimaryKeyConstraint("seq", name="pk_index_changes"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_index_changes_tenant_map_number_seq", "index_changes", ["tenant", "map_number", "seq"])


def _create_workers() -> None:
    op.create_table(
        "workers",
        sa.Column("worker_id", sa.String(length=64), nullable=False),
        sa.Column("model_version", sa.String(length=128), nullable=False),
        sa.Column("epoch", sa.String(length=64), nullable=False),
        sa.Column("seen_ms", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("worker_id", name="pk_workers"),
    )
