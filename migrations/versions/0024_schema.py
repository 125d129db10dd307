"""The schema of revision 0024, whose steps from the first one on nobody needs any more: nothing was released before.

Columns stand in the order in which those steps left them. The number of the first revision stays that of the last step,
so that a store of it needs no change (docs/decisions/0325).
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = None
branch_labels = None
depends_on = None

schema = sa.MetaData()

NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
"""Of rows: SQLite's INTEGER has 64 bits, and counts by itself where it is the primary key."""


def upgrade() -> None:
    """Create every table with its indexes; nobody may change or delete a row of the audit log."""
    schema.create_all(op.get_bind(), checkfirst=False)
    for statement in ON_POSTGRESQL if _on_postgresql() else ON_SQLITE:
        op.execute(statement)


def downgrade() -> None:
    """Drop every table, children first; indexes and triggers go with theirs."""
    schema.drop_all(op.get_bind(), checkfirst=False)
    if _on_postgresql():
        op.execute("DROP TABLE audit_height")
        op.execute("DROP FUNCTION audit_log_refuses, audit_log_grows")


ON_SQLITE = [
    f"CREATE TRIGGER audit_log_refuses_{change.lower()} BEFORE {change} ON audit_log "
    "BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END"
    for change in ("UPDATE", "DELETE")
]
ON_POSTGRESQL = [
    "CREATE FUNCTION audit_log_refuses() RETURNS trigger LANGUAGE plpgsql AS "
    "$$ BEGIN RAISE EXCEPTION 'the audit log is append-only'; END $$",
    "CREATE TRIGGER audit_log_refuses_change BEFORE UPDATE OR DELETE OR TRUNCATE ON audit_log "
    "FOR EACH STATEMENT EXECUTE FUNCTION audit_log_refuses()",
    # SQLite keeps the highest number of a table by itself; a sequence counts what was rolled back, too.
    "CREATE TABLE audit_height (number BIGINT NOT NULL)",
    "INSERT INTO audit_height VALUES (0)",
    "CREATE FUNCTION audit_log_grows() RETURNS trigger LANGUAGE plpgsql AS "
    "$$ BEGIN UPDATE audit_height SET number = greatest(number, NEW.number); RETURN NEW; END $$",
    "CREATE TRIGGER audit_log_grows AFTER INSERT ON audit_log FOR EACH ROW EXECUTE FUNCTION audit_log_grows()",
]


def _on_postgresql() -> bool:
    return op.get_bind().dialect.name == "postgresql"


def _table(name: str, *parts: sa.Column | sa.Constraint) -> None:
    """A table whose rows have a checksum, but for the audit log: its rows have a chain of hashes (decision 0032)."""
    checksum = () if name == "audit_log" else (_big("checksum", null=True),)
    columns = [part for part in parts if isinstance(part, sa.Column)]
    sa.Table(name, schema, *columns, *checksum, *parts[len(columns) :], sqlite_autoincrement=True)


def _numbered(name: str, *parts: sa.Column | sa.Constraint) -> None:
    """A table whose rows have a number that is never given out twice."""
    _table(name, sa.Column("number", NUMBER, primary_key=True, autoincrement=True), *parts)


def _index(name: str, table: str, *columns: str, where: str | None = None) -> None:
    rows = None if where is None else sa.text(where)
    sa.Index(name, *(schema.tables[table].c[column] for column in columns), sqlite_where=rows, postgresql_where=rows)


def _refers(name: str, table: str, own: tuple[str, ...], others: tuple[str, ...] = ()) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(own, [f"{table}.{column}" for column in others or own], name=name)


def _column(name: str, kind: sa.types.TypeEngine, null: bool, default: str | None) -> sa.Column:
    return sa.Column(name, kind, nullable=null, server_default=default)


def _text(name: str, length: int = 64, *, null: bool = False) -> sa.Column:
    return _column(name, sa.String(length), null, None)


def _big(name: str, *, null: bool = False, default: str | None = None) -> sa.Column:
    return _column(name, sa.BigInteger(), null, default)


def _int(name: str) -> sa.Column:
    return _column(name, NUMBER, False, None)


def _real(name: str, *, null: bool = False, default: str | None = None) -> sa.Column:
    return _column(name, sa.Float(), null, default)


def _json(name: str, *, null: bool = False) -> sa.Column:
    return _column(name, sa.JSON(), null, None)


def _bytes(name: str, *, null: bool = False, default: str | None = None) -> sa.Column:
    return _column(name, sa.LargeBinary(), null, default)


def _long(name: str, *, null: bool = False) -> sa.Column:
    return _column(name, sa.Text(), null, None)


def _flag(name: str, *, default: str | None = None) -> sa.Column:
    return _column(name, sa.Boolean(), False, default)


_numbered(
    "maps",
    _text("tenant"), _text("map_id"), _text("content_hash"), _text("display_name", 256), _real("tau_m", null=True),
    _real("stride_m", null=True), _text("model_version", 128, null=True), _big("created_at_ns"),
    _real("scene_scale", default="1.0"), _big("loop_candidates", null=True), _real("min_score", null=True),
    _real("min_overlap", null=True), _real("max_seen_through", null=True), _big("map_version", default="0"),
    _big("graph_edits", default="0"), _text("index_file", 128, null=True), _real("leave_distance_m", null=True),
    sa.UniqueConstraint("tenant", "map_id", name="uq_maps_tenant_map_id"),
)
_numbered(
    "robots",
    _text("tenant"), _text("robot_id"), _text("content_hash"), _text("display_name", 256), _big("created_at_ns"),
    sa.UniqueConstraint("tenant", "robot_id", name="uq_robots_tenant_robot_id"),
)
_numbered(
    "sessions",
    _text("tenant"), _text("map_id"), _text("session_id"), _text("content_hash"), _text("robot_id", null=True),
    _text("state", 16), _big("committed_seq"), _big("next_ordinal"), _real("travelled_m"), _real("window_start_m"),
    _big("window_first_seq"), _real("emitted_to_m", null=True), _big("created_at_ns"),
    _big("finished_at_ns", null=True), _text("storey", null=True),
    _refers("fk_sessions_maps_tenant_map_id", "maps", ("tenant", "map_id")),
    _refers("fk_sessions_robots_tenant_robot_id", "robots", ("tenant", "robot_id")),
    sa.UniqueConstraint("tenant", "map_id", "session_id", name="uq_sessions_tenant_map_id_session_id"),
)
_index("ix_sessions_tenant_map_id_storey", "sessions", "tenant", "map_id", "storey")
_numbered(
    "scans",
    _text("tenant"), _text("map_id"), _text("session_id"), _big("seq"), _big("stamp_ns"), _real("travelled_m"),
    _big("point_count"), _text("cloud_sha256"), _bytes("T_odom_sensor", default=""),
    _refers("fk_scans_sessions_tenant_map_id_session_id", "sessions", ("tenant", "map_id", "session_id")),
    sa.UniqueConstraint("tenant", "map_id", "session_id", "seq", name="uq_scans_tenant_map_id_session_id_seq"),
)
_index("ix_scans_tenant_cloud_sha256", "scans", "tenant", "cloud_sha256")
_index("ix_scans_tenant_map_id_session_id_travelled_m", "scans", "tenant", "map_id", "session_id", "travelled_m")
_numbered(
    "submaps",
    _text("tenant"), _text("map_id"), _text("session_id"), _text("submap_id"), _text("content_hash"),
    _text("state", 16), _big("ordinal"), _big("session_number"), _json("position_m"), _big("stamp_ns"),
    _text("cloud_sha256", null=True), _big("first_seq", null=True), _big("last_seq", null=True), _big("scan_count"),
    _big("point_count"), _text("operation_id"), _json("flags"), _big("created_at_ns"),
    _text("model_version", 128, null=True), _bytes("descriptor", null=True), _text("signature_sha256", null=True),
    _text("neural_map_sha256", null=True), _big("neural_map_bytes", null=True), _text("failure_code", null=True),
    _long("failure_message", null=True), _bytes("T_odom_submap", default=""),
    _refers("fk_submaps_sessions_tenant_map_id_session_id", "sessions", ("tenant", "map_id", "session_id")),
    sa.UniqueConstraint("tenant", "map_id", "session_id", "submap_id", name="uq_submaps_tenant_map_id_session_id_submap_id"),
)
_index("ix_submaps_state_tenant_map_id", "submaps", "state", "tenant", "map_id")
_index("ix_submaps_tenant_cloud_sha256", "submaps", "tenant", "cloud_sha256")
_index("ix_submaps_tenant_map_id_session_id_ordinal", "submaps", "tenant", "map_id", "session_id", "ordinal")
_index("ix_submaps_tenant_neural_map_sha256", "submaps", "tenant", "neural_map_sha256")
_index("ix_submaps_tenant_signature_sha256", "submaps", "tenant", "signature_sha256")
_numbered(
    "loop_closures",
    _text("tenant"), _text("map_id"), _text("loop_id"), _int("query_number"), _int("match_number"),
    _text("query_session_id"), _text("query_submap_id"), _text("match_session_id"), _text("match_submap_id"),
    _text("state", 16), _text("reason", null=True), _real("similarity"), _real("score"), _big("created_at_ns"),
    _text("graph_state", 16, null=True), _flag("manual", default="0"), _bytes("T_match_query", null=True),
    _bytes("evidence", default=""),
    _refers("fk_loop_closures_submaps_match_number", "submaps", ("match_number",), ("number",)),
    _refers("fk_loop_closures_submaps_query_number", "submaps", ("query_number",), ("number",)),
    _refers("fk_loop_closures_maps_tenant_map_id", "maps", ("tenant", "map_id")),
    sa.UniqueConstraint("tenant", "map_id", "loop_id", name="uq_loop_closures_tenant_map_id_loop_id"),
)
_index("ix_loop_closures_match_number", "loop_closures", "match_number")
_index("ix_loop_closures_query_number", "loop_closures", "query_number")
_index("ix_loop_closures_tenant_map_id_state", "loop_closures", "tenant", "map_id", "state")
_numbered(
    "loop_events",
    _text("tenant"), _text("map_id"), _text("loop_id"), _text("kind", 16), _text("state", 16),
    _text("reason", null=True), _text("graph_state", 16, null=True), _text("actor", 128), _long("note"),
    _big("map_version"), _int("query_number"), _int("match_number"), _text("query_session_id"),
    _text("match_session_id"), _big("at_ns"), _bytes("T_match_query", null=True), _bytes("details", default=""),
    sa.UniqueConstraint("tenant", "number", name="uq_loop_events_tenant_number"),
    _refers("fk_loop_events_maps_tenant_map_id", "maps", ("tenant", "map_id")),
)
_index("ix_loop_events_match_number", "loop_events", "match_number")
_index("ix_loop_events_query_number", "loop_events", "query_number")
_index("ix_loop_events_tenant_map_id_loop_id", "loop_events", "tenant", "map_id", "loop_id")
_numbered(
    "jobs",
    _text("tenant"), _text("operation_id"), _text("kind", 32), _text("state", 16), _text("subject", 256),
    _json("payload"), _big("attempts"), _big("max_attempts"), _big("created_at_ns"), _big("priority"),
    _text("lease_owner", null=True), _big("lease_token"), _text("lease_epoch"), _big("not_before_ms"),
    _big("lease_expires_ms"), _json("result", null=True), _text("failure_code", null=True),
    _long("failure_message", null=True), _big("finished_at_ns", null=True), _text("request_id", null=True),
    _text("traceparent", null=True), _big("claimed_ms", default="0"), _big("forgiven", default="0"),
    _json("progress", null=True), _flag("cancel_requested", default="0"),
    sa.UniqueConstraint("tenant", "operation_id", name="uq_jobs_tenant_operation_id"),
)
_index("ix_jobs_finished_at_ns", "jobs", "finished_at_ns", where="priority = 0")
_index("ix_jobs_state_tenant_priority", "jobs", "state", "tenant", "priority")
_index("ix_jobs_tenant_state", "jobs", "tenant", "state")
_table(
    "index_changes",
    sa.Column("seq", NUMBER, primary_key=True), _text("tenant"), _int("map_number"), _int("submap_number"),
    _text("kind", 16),
)
_index("ix_index_changes_tenant_map_number_seq", "index_changes", "tenant", "map_number", "seq")
_table(
    "workers",
    _text("worker_id"), _text("model_version", 128), _text("epoch"), _big("seen_ms"),
    sa.PrimaryKeyConstraint("worker_id", name="pk_workers"),
)
_table(
    "tenant_turns",
    _text("tenant"), _big("started_ms"), _big("spent_ms"),
    sa.PrimaryKeyConstraint("tenant", name="pk_tenant_turns"),
)
_table(
    "last_submaps",
    _text("tenant"), _big("number"),
    sa.PrimaryKeyConstraint("tenant", name="pk_last_submaps"),
)
_numbered(
    "deletions",
    _text("tenant"), _text("map_id"), _text("session_id"), _big("created_at_ns"),
    sa.UniqueConstraint("tenant", "map_id", "session_id", name="uq_deletions_tenant_map_id_session_id"),
)
_numbered(
    "map_versions",
    _text("tenant"), _text("map_id"), _big("version"), _big("restored_from", null=True),
    _text("operation_id", null=True), _json("summary"), _bytes("loops"), _text("loops_hash"), _big("created_at_ns"),
    sa.UniqueConstraint("tenant", "map_id", "version", name="uq_map_versions_tenant_map_id_version"),
    _refers("fk_map_versions_maps_tenant_map_id", "maps", ("tenant", "map_id")),
)
_numbered(
    "session_poses",
    _text("tenant"), _text("map_id"), _big("version"), _text("session_id"), _big("session_number"), _text("frame"),
    _bytes("submaps"), _text("content_hash"), _big("created_at_ns"), _bytes("T_map_odom", default=""),
    sa.UniqueConstraint("tenant", "map_id", "version", "session_id", name="uq_session_poses_tenant_map_id_version_session_id"),
    _refers("fk_session_poses_sessions_tenant_map_id_session_id", "sessions", ("tenant", "map_id", "session_id")),
    _refers("fk_session_poses_map_versions_tenant_map_id_version", "map_versions", ("tenant", "map_id", "version")),
)
_index("ix_session_poses_tenant_map_id_session_id", "session_poses", "tenant", "map_id", "session_id")
_numbered(
    "early_corrections",
    _text("tenant"), _text("map_id"), _text("session_id"), _big("version"), _big("loops"), _big("created_at_ns"),
    _bytes("T_map_odom", default=""),
    _refers("fk_early_corrections_sessions_tenant", "sessions", ("tenant", "map_id", "session_id")),
    sa.UniqueConstraint("tenant", "map_id", "session_id", name="uq_early_corrections_tenant_map_id_session_id"),
)
_numbered(
    "map_merges",
    _text("tenant"), _text("map_id"), _text("merge_id"), _text("source", 300), _big("version_before"),
    _big("version"), _json("sessions"), _json("report"), _big("created_at_ns"), _big("reverted_at_ns", null=True),
    _refers("fk_map_merges_maps_tenant", "maps", ("tenant", "map_id")),
    sa.UniqueConstraint("tenant", "map_id", "merge_id", name="uq_map_merges_tenant_map_id_merge_id"),
)
_numbered(
    "map_tiles",
    _text("tenant"), _text("map_id"), _big("version"), _text("tile_id"), _text("tile_sha256"), _big("submaps"),
    _big("created_at_ns"),
    _refers("fk_map_tiles_maps_tenant", "maps", ("tenant", "map_id")),
    sa.UniqueConstraint("tenant", "map_id", "version", "tile_id", name="uq_map_tiles_tenant_map_id_version_tile_id"),
)
_index("ix_map_tiles_tenant_tile_sha256", "map_tiles", "tenant", "tile_sha256")
_numbered(
    "map_files",
    _text("tenant"), _text("map_id"), _big("version"), _text("sha256"), _big("size_bytes"), _text("layout_sha256"),
    _json("sessions"), _big("submaps"), _text("state", 16), _long("description"), _big("created_at_ns"),
    _refers("fk_map_files_maps_tenant", "maps", ("tenant", "map_id")),
    sa.UniqueConstraint("tenant", "map_id", "version", name="uq_map_files_tenant_map_id_version"),
)
_index("ix_map_files_tenant_layout_sha256", "map_files", "tenant", "layout_sha256")
_numbered(
    "events",
    _text("tenant"), _text("map_id"), _text("kind", 16), _text("subject"),
)
_index("ix_events_tenant_number", "events", "tenant", "number")
_numbered(
    "webhooks",
    _text("tenant"), _text("webhook_id"), _text("content_hash"), _long("url"), _text("map_id", null=True),
    _json("kinds"), _text("secret"), _text("state", 16), _big("told"), _big("failures"), _big("due_at_ns"),
    _big("created_at_ns"),
    sa.UniqueConstraint("tenant", "webhook_id", name="uq_webhooks_tenant_webhook_id"),
)
_numbered(
    "webhook_deliveries",
    _text("tenant"), _text("webhook_id"), _big("first_event"), _big("last_event"), _big("events"), _big("attempt"),
    _big("status", null=True), _long("error", null=True), _big("took_ms"), _big("at_ns"),
)
_index("ix_webhook_deliveries_tenant_webhook_id", "webhook_deliveries", "tenant", "webhook_id")
_numbered(
    "api_keys",
    _text("tenant"), _text("key_id"), _text("label", 256), _json("scopes"), _text("secret_sha256"),
    _big("created_at_ns"), _big("expires_at_ns", null=True), _big("revoked_at_ns", null=True),
    _text("successor_id", null=True),
    sa.UniqueConstraint("key_id", name="uq_api_keys_key_id"),
)
_numbered(
    "audit_log",
    _big("at_ns"), _text("tenant"), _text("actor", 256), _text("action", 32), _text("subject", 256), _json("detail"),
    _text("previous_hash"), _text("hash"),
)
