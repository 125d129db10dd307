"""Tables: one per record of `contract.records`, a column per field.

Statements are built from them; the schema itself is created by migrations/, which also state two more rules: a number
is never given out twice, and an index may hold some rows only (`info["where"]`). The tenant is first in every index,
but for those with a comment on the statement that is of all tenants.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKeyConstraint,
    Index,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
)

from revisit.core.config import Profile
from revisit.formats.pictures import JPEG, PNG
from revisit.service.domain.records import SessionDetails
from revisit.service.engines.sql.packed_columns import JsonTuple, PackedEvidence, PackedPose, StoredJson, StoredWord

NAMING = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "fk": "fk_%(table_name)s_%(referred_table_name)s_%(column_0_N_name)s",
    "pk": "pk_%(table_name)s",
}
metadata = MetaData(naming_convention=NAMING)

ANSWERED_QUERIES = "priority = 0"
"""The condition of the index of jobs by their end: those of queries, with answers that expire."""

ACCEPTED = "state = 'ACCEPTED'"
"""The condition of the index of loops in the order in which they were accepted."""

UNSEARCHED = "NOT searched"
"""The condition of the index of submaps with loops that are still searched for: a few at a time."""


def _numbered(name: str, key: tuple[str, ...], *columns: Any) -> Table:
    """A table of rows with a tenant, a number that is never used twice, and a `key` unique within the tenant."""
    return Table(
        name,
        metadata,
        Column("number", BigInteger, primary_key=True, autoincrement=True),
        Column("tenant", String(64), nullable=False),
        *columns,
        UniqueConstraint("tenant", *key),
        info={"key": key},
    )


def _text(name: str, *, length: int = 64, nullable: bool = False) -> Column[str]:
    return Column(name, String(length), nullable=nullable)


def _integer(name: str, *, nullable: bool = False) -> Column[int]:
    return Column(name, BigInteger, nullable=nullable)


def _real(name: str, *, nullable: bool = False) -> Column[float]:
    return Column(name, Float, nullable=nullable)


def _json(name: str, *, nullable: bool = False) -> Column[Any]:
    return Column(name, StoredJson(), nullable=nullable)


def _tuple(name: str, *, nullable: bool = False) -> Column[tuple[Any, ...]]:
    return Column(name, JsonTuple(), nullable=nullable)


def _pose(name: str, *, nullable: bool = False) -> Column[tuple[float, ...]]:
    return Column(name, PackedPose(), nullable=nullable)


maps = _numbered(
    "maps",
    ("map_id",),
    _text("map_id"),
    _text("content_hash"),
    _text("display_name", length=256),
    _real("tau_m", nullable=True),
    _real("stride_m", nullable=True),
    _real("leave_distance_m", nullable=True),
    Column("scene_scale", Float, nullable=False, server_default="1.0"),
    _integer("loop_candidates", nullable=True),
    _real("min_score", nullable=True),
    _real("min_overlap", nullable=True),
    _real("max_seen_through", nullable=True),
    _text("model_version", length=128, nullable=True),
    _integer("created_at_ns"),
    Column("map_version", BigInteger, nullable=False, server_default="0"),
    Column("graph_edits", BigInteger, nullable=False, server_default="0"),
    _text("index_file", length=128, nullable=True),
    Column("profile", StoredWord(tuple(Profile), 16), nullable=False, server_default="product"),
    _text("retention", length=256, nullable=True),
    _json("retention_run", nullable=True),
    _tuple("origin", nullable=True),
)

robots = _numbered(
    "robots",
    ("robot_id",),
    _text("robot_id"),
    _text("content_hash"),
    _text("display_name", length=256),
    _integer("created_at_ns"),
)

sessions = _numbered(
    "sessions",
    ("map_id", "session_id"),
    _text("map_id"),
    _text("session_id"),
    _text("content_hash"),
    _text("robot_id", nullable=True),
    _text("state", length=16),
    _integer("committed_seq"),
    _integer("next_ordinal"),
    _real("travelled_m"),
    _real("window_start_m"),
    _integer("window_first_seq"),
    _real("emitted_to_m", nullable=True),
    _integer("created_at_ns"),
    _integer("finished_at_ns", nullable=True),
    *(_text(detail.name, nullable=True) for detail in fields(SessionDetails)),
    _text("stream", length=32, nullable=True),
    _text("changes_told", nullable=True),
    ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"]),
    ForeignKeyConstraint(["tenant", "robot_id"], ["robots.tenant", "robots.robot_id"]),
    Index(None, "tenant", "map_id", "storey"),
)

scans = _numbered(
    "scans",
    ("map_id", "session_id", "seq"),
    _text("map_id"),
    _text("session_id"),
    _integer("seq"),
    _integer("stamp_ns"),
    _pose("T_odom_sensor"),
    _real("travelled_m"),
    _integer("point_count"),
    _text("cloud_sha256"),
    Column("chosen", Boolean, nullable=False, server_default="0"),
    ForeignKeyConstraint(
        ["tenant", "map_id", "session_id"], ["sessions.tenant", "sessions.map_id", "sessions.session_id"]
    ),
    Index(None, "tenant", "map_id", "session_id", "travelled_m"),
    Index(None, "tenant", "cloud_sha256"),
)

submaps = _numbered(
    "submaps",
    ("map_id", "session_id", "submap_id"),
    _text("map_id"),
    _text("session_id"),
    _text("submap_id"),
    _text("content_hash"),
    _text("state", length=16),
    _integer("ordinal"),
    _integer("session_number"),
    _pose("T_odom_submap"),
    _tuple("position_m"),
    _integer("stamp_ns"),
    _text("cloud_sha256", nullable=True),
    _integer("first_seq", nullable=True),
    _integer("last_seq", nullable=True),
    _integer("scan_count"),
    _integer("point_count"),
    _text("operation_id"),
    _tuple("flags"),
    _integer("created_at_ns"),
    _text("model_version", length=128, nullable=True),
    Column("descriptor", LargeBinary, nullable=True),
    # The name of version 0.1: `restore` checks a backup by this column before it migrates anything.
    Column("signature_sha256", String(64), key="place_sha256", nullable=True),
    _text("neural_map_sha256", nullable=True),
    _integer("neural_map_bytes", nullable=True),
    _text("failure_code", nullable=True),
    Column("failure_message", Text, nullable=True),
    Column("entered", BigInteger, nullable=False, server_default="0"),
    Column("map_version", BigInteger, nullable=False, server_default="0"),
    Column("searched", Boolean, nullable=False, server_default="1"),
    Column("seq", BigInteger, nullable=False, server_default="0"),
    _integer("described_at_ns", nullable=True),
    Column("kept_scans", String(16), nullable=False, server_default="ALL"),
    Column("radio", LargeBinary, nullable=True),
    # No field of the record: the engine keeps it, if it keeps any (see `checksums`).
    _integer("checksum", nullable=True),
    ForeignKeyConstraint(
        ["tenant", "map_id", "session_id"], ["sessions.tenant", "sessions.map_id", "sessions.session_id"]
    ),
    # The metrics count states over all tenants; `first_waiting` gives all three columns.
    Index(None, "state", "tenant", "map_id"),
    Index(None, "tenant", "map_id", info={"where": UNSEARCHED}),
    Index(None, "tenant", "map_id", "kept_scans"),
    Index(None, "tenant", "map_id", "session_id", "ordinal"),
    Index(None, "tenant", "cloud_sha256"),
    Index(None, "tenant", "place_sha256"),
    Index(None, "tenant", "neural_map_sha256"),
)

loops = _numbered(
    "loop_closures",
    ("map_id", "loop_id"),
    _text("map_id"),
    _text("loop_id"),
    Column("query_number", BigInteger, nullable=False),
    Column("match_number", BigInteger, nullable=False),
    _text("query_session_id"),
    _text("query_submap_id"),
    _text("match_session_id"),
    _text("match_submap_id"),
    _text("state", length=16),
    _text("reason", nullable=True),
    _real("similarity"),
    _real("score"),
    _pose("T_match_query", nullable=True),
    Column("evidence", PackedEvidence(), nullable=False),
    _integer("created_at_ns"),
    _text("graph_state", length=16, nullable=True),
    Column("manual", Boolean, nullable=False, server_default="0"),
    Column("seq", BigInteger, nullable=False, server_default="0"),
    ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"]),
    ForeignKeyConstraint(["query_number"], ["submaps.number"]),
    ForeignKeyConstraint(["match_number"], ["submaps.number"]),
    Index(None, "tenant", "map_id", "state"),
    Index(None, "tenant", "map_id", "seq", info={"where": ACCEPTED}),
    # The numbers are those of submaps, of one tenant each; the foreign keys look for a number when a submap goes.
    Index(None, "query_number"),
    Index(None, "match_number"),
)

loop_events = _numbered(
    "loop_events",
    ("number",),
    _text("map_id"),
    _text("loop_id"),
    _text("kind", length=16),
    _text("state", length=16),
    _text("reason", nullable=True),
    _text("graph_state", length=16, nullable=True),
    _pose("T_match_query", nullable=True),
    _text("actor", length=128),
    Column("note", Text, nullable=False),
    _integer("map_version"),
    Column("details", PackedEvidence(), nullable=False),
    Column("query_number", BigInteger, nullable=False),
    Column("match_number", BigInteger, nullable=False),
    _text("query_session_id"),
    _text("match_session_id"),
    _integer("at_ns"),
    ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"]),
    Index(None, "tenant", "map_id", "loop_id"),
    # As those of the loops; they go with a submap.
    Index(None, "query_number"),
    Index(None, "match_number"),
)

map_versions = _numbered(
    "map_versions",
    ("map_id", "version"),
    _text("map_id"),
    _integer("version"),
    _integer("restored_from", nullable=True),
    _text("operation_id", nullable=True),
    _json("summary"),
    Column("loops", LargeBinary, nullable=False),
    _text("loops_hash"),
    _integer("created_at_ns"),
    Column("anchors", LargeBinary, nullable=True),
    ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"]),
)

session_poses = _numbered(
    "session_poses",
    ("map_id", "version", "session_id"),
    _text("map_id"),
    _integer("version"),
    _text("session_id"),
    _integer("session_number"),
    _text("frame"),
    _pose("T_map_odom"),
    Column("submaps", LargeBinary, nullable=False),
    _text("content_hash"),
    _integer("created_at_ns"),
    ForeignKeyConstraint(
        ["tenant", "map_id", "session_id"], ["sessions.tenant", "sessions.map_id", "sessions.session_id"]
    ),
    ForeignKeyConstraint(
        ["tenant", "map_id", "version"], ["map_versions.tenant", "map_versions.map_id", "map_versions.version"]
    ),
    Index(None, "tenant", "map_id", "session_id"),
)

anchors = _numbered(
    "anchors",
    ("map_id", "session_id", "anchor_id"),
    _text("map_id"),
    _text("session_id"),
    _text("anchor_id"),
    _text("content_hash"),
    _text("kind", length=16),
    _text("frame", length=16),
    _integer("stamp_ns"),
    _tuple("position"),
    _tuple("covariance"),
    _tuple("offset_m"),
    _pose("T_odom_sensor"),
    _real("heading_rad", nullable=True),
    _real("heading_sigma_rad", nullable=True),
    _integer("created_at_ns"),
    _text("tag", nullable=True),
    ForeignKeyConstraint(
        ["tenant", "map_id", "session_id"], ["sessions.tenant", "sessions.map_id", "sessions.session_id"]
    ),
)

radio_readings = _numbered(
    "radio_readings",
    ("map_id", "session_id", "stamp_ns"),
    _text("map_id"),
    _text("session_id"),
    _integer("stamp_ns"),
    _integer("time_slice"),
    Column("heard", LargeBinary, nullable=False),
    ForeignKeyConstraint(
        ["tenant", "map_id", "session_id"], ["sessions.tenant", "sessions.map_id", "sessions.session_id"]
    ),
    Index(None, "tenant", "map_id", "session_id", "time_slice"),
)

early_corrections = _numbered(
    "early_corrections",
    ("map_id", "session_id"),
    _text("map_id"),
    _text("session_id"),
    _integer("version"),
    _integer("loops"),
    _pose("T_map_odom"),
    _integer("created_at_ns"),
    ForeignKeyConstraint(
        ["tenant", "map_id", "session_id"], ["sessions.tenant", "sessions.map_id", "sessions.session_id"]
    ),
)

deletions = _numbered(
    "deletions",
    ("map_id", "session_id"),
    _text("map_id"),
    _text("session_id"),
    _integer("created_at_ns"),
)

map_merges = _numbered(
    "map_merges",
    ("map_id", "merge_id"),
    _text("map_id"),
    _text("merge_id"),
    _text("source", length=300),
    _integer("version_before"),
    _integer("version"),
    _tuple("sessions"),
    _json("report"),
    _integer("created_at_ns"),
    _integer("reverted_at_ns", nullable=True),
    ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"]),
)

map_tiles = _numbered(
    "map_tiles",
    ("map_id", "version", "tile_id"),
    _text("map_id"),
    _integer("version"),
    _text("tile_id"),
    _text("tile_sha256"),
    _integer("submaps"),
    _integer("created_at_ns"),
    ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"]),
    Index(None, "tenant", "tile_sha256"),
)

map_files = _numbered(
    "map_files",
    ("map_id", "version"),
    _text("map_id"),
    _integer("version"),
    _text("sha256"),
    _integer("size_bytes"),
    _text("layout_sha256"),
    _tuple("sessions"),
    _integer("submaps"),
    _text("state", length=16),
    Column("description", Text, nullable=False),
    _integer("created_at_ns"),
    ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"]),
    Index(None, "tenant", "layout_sha256"),
)

plans = _numbered(
    "plans",
    ("map_id", "plan_id"),
    _text("map_id"),
    _text("plan_id"),
    _text("content_hash"),
    _text("display_name", length=256),
    _text("storey", nullable=True),
    Column("media_type", StoredWord((PNG, JPEG), 16), nullable=False),
    _integer("width_px"),
    _integer("height_px"),
    _integer("size_bytes"),
    _text("image_sha256"),
    _text("frame", length=32),
    _tuple("pins"),
    _integer("created_at_ns"),
    ForeignKeyConstraint(["tenant", "map_id"], ["maps.tenant", "maps.map_id"]),
    Index(None, "tenant", "image_sha256"),
)

jobs = _numbered(
    "jobs",
    ("operation_id",),
    _text("operation_id"),
    _text("kind", length=32),
    _text("state", length=16),
    _text("subject", length=256),
    _json("payload"),
    _integer("attempts"),
    _integer("max_attempts"),
    _integer("created_at_ns"),
    _integer("priority"),
    _text("lease_owner", nullable=True),
    Column("lease_id", String(32), nullable=False, server_default=""),
    Column("claimed_ms", BigInteger, nullable=False, server_default="0"),
    _integer("not_before_ms"),
    _integer("lease_expires_ms"),
    _text("request_id", nullable=True),
    _text("traceparent", nullable=True),
    _json("result", nullable=True),
    _text("failure_code", nullable=True),
    Column("failure_message", Text, nullable=True),
    _integer("finished_at_ns", nullable=True),
    Column("forgiven", BigInteger, nullable=False, server_default="0"),
    _json("progress", nullable=True),
    Column("cancel_requested", Boolean, nullable=False, server_default="0"),
    # Claims go from tenant to tenant with jobs of a state, and look for lost leases of all of them.
    Index(None, "state", "tenant", "priority", "number"),
    Index(None, "tenant", "state"),
    # Answers expire whoever has asked.
    Index(None, "finished_at_ns", info={"where": ANSWERED_QUERIES}),
)

unreferenced_blobs = Table(
    "unreferenced_blobs",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=True),
    Column("tenant", String(64), nullable=False),
    _text("kind", length=32),
    _text("sha256"),
    _text("state", length=16),
    _integer("since_ms"),
    Index(None, "tenant", "sha256"),
    # One sweep collects the blobs of all tenants.
    Index(None, "state", "since_ms"),
)

index_changes = Table(
    "index_changes",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=True),
    Column("tenant", String(64), nullable=False),
    Column("map_number", BigInteger, nullable=False),
    Column("submap_number", BigInteger, nullable=False),
    Column("kind", String(16), nullable=False),
    # Within the map, as in the two tables below (see `map_numbers`).
    Column("seq", BigInteger, nullable=False, server_default="0"),
    Index(None, "tenant", "map_number", "seq"),
)

events = Table(
    "events",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=True),
    Column("tenant", String(64), nullable=False),
    _text("map_id"),
    _text("kind", length=16),
    _text("subject"),
    Column("seq", BigInteger, nullable=False, server_default="0"),
    Index(None, "tenant", "map_id", "seq"),
)

map_counters = Table(
    "map_counters",
    metadata,
    Column("tenant", String(64), primary_key=True),
    Column("map_id", String(64), primary_key=True),
    _integer("changes"),
    _integer("events"),
    _integer("submaps"),
    _integer("forgotten"),
)

webhooks = _numbered(
    "webhooks",
    ("webhook_id",),
    _text("webhook_id"),
    _text("content_hash"),
    Column("url", Text, nullable=False),
    _text("map_id", nullable=True),
    _tuple("kinds"),
    _text("secret"),
    _text("state", length=16),
    _integer("told"),
    _integer("failures"),
    _integer("due_at_ns"),
    _integer("created_at_ns"),
)

webhook_positions = Table(
    "webhook_positions",
    metadata,
    # The number is that of a webhook, of one tenant.
    Column("webhook_number", BigInteger, primary_key=True, autoincrement=False),
    Column("map_id", String(64), primary_key=True),
    Column("tenant", String(64), nullable=False),
    _integer("told"),
    Index(None, "tenant", "map_id"),
)

webhook_deliveries = Table(
    "webhook_deliveries",
    metadata,
    Column("number", BigInteger, primary_key=True, autoincrement=True),
    Column("tenant", String(64), nullable=False),
    _text("webhook_id"),
    _integer("first_event"),
    _integer("last_event"),
    _integer("events"),
    _integer("attempt"),
    _integer("status", nullable=True),
    Column("error", Text, nullable=True),
    _integer("took_ms"),
    _integer("at_ns"),
    Index(None, "tenant", "webhook_id"),
    info={"key": ("number",)},
)

workers = Table(
    "workers",
    metadata,
    Column("worker_id", String(64), primary_key=True),
    Column("model_version", String(128), nullable=False),
    Column("seen_ms", BigInteger, nullable=False),
)

processes = Table(
    "processes",
    metadata,
    Column("process_id", String(64), primary_key=True),
    Column("role", String(16), nullable=False),
    Column("address", String(255), nullable=False),
    Column("ready", Boolean, nullable=False),
    Column("busy", StoredJson(), nullable=False),
    Column("came_ms", BigInteger, nullable=False),
    Column("seen_ms", BigInteger, nullable=False),
)

worker_turns = Table(
    "worker_turns",
    metadata,
    Column("tenant", String(64), primary_key=True),
    Column("worker_id", String(64), primary_key=True),
    Column("started_ms", BigInteger, nullable=False),
    Column("ran_ms", BigInteger, nullable=False),
    Column("lifted_ms", BigInteger, nullable=False),
    # The latest start of all tenants.
    Index(None, "started_ms"),
)
