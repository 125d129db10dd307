"""Rows to fill a store with."""

from __future__ import annotations

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import (
    JobRecord,
    LoopRecord,
    MapRecord,
    RobotRecord,
    ScanRecord,
    SessionRecord,
    SubmapRecord,
)
from revisit.service.ports.index import VectorFilter

TENANT = TenantId("default")
POSE = tuple(float(value) for value in (1, 0, 0, 0.1, 0, 1, 0, 0.2, 0, 0, 1, 0.3, 0, 0, 0, 1))


def a_map(map_id="town", tenant=TENANT) -> MapRecord:
    return MapRecord(tenant, map_id, "hash", "Town", None, 5.0, None, None, 1)


def a_robot(robot_id="rover") -> RobotRecord:
    return RobotRecord(TENANT, robot_id, "hash", "Rover", 1)


def a_session(session_id="monday", map_id="town", tenant=TENANT, robot_id=None) -> SessionRecord:
    return SessionRecord(tenant, map_id, session_id, "hash", robot_id, "ACTIVE", 0, 0, 0.0, 0.0, 1, None, 1, None)


def a_scan(seq=1, travelled_m=0.0, session_id="monday", tenant=TENANT) -> ScanRecord:
    return ScanRecord(tenant, "town", session_id, seq, seq * 100, POSE, travelled_m, 300, "c" * 64)


def a_submap(submap_id="a", ordinal=0, tenant=TENANT, session_number=1, **fields) -> SubmapRecord:
    values = {
        "tenant": tenant,
        "map_id": "town",
        "session_id": "monday",
        "submap_id": submap_id,
        "content_hash": "hash",
        "state": "QUEUED",
        "ordinal": ordinal,
        "session_number": session_number,
        "T_odom_submap": POSE,
        "position_m": (0.1, 0.2, 0.3),
        "stamp_ns": 100,
        "cloud_sha256": "c" * 64,
        "first_seq": None,
        "last_seq": None,
        "scan_count": 1,
        "point_count": 300,
        "operation_id": "op-1",
        "flags": ("degenerate_plane",),
        "created_at_ns": 1,
    }
    return SubmapRecord(**{**values, **fields})


def a_loop(query_number, match_number) -> LoopRecord:
    names = ("monday", "a", "monday", "b")
    evidence = {"inliers": 12, "rmse_m": 0.1}
    ids = (TENANT, "town", f"loop-{query_number}-{match_number}", query_number, match_number)
    return LoopRecord(*ids, *names, "ACCEPTED", None, 0.9, 0.8, POSE, evidence, 1)


def a_job(operation_id="op-1", tenant=TENANT, **fields) -> JobRecord:
    values = {
        "tenant": tenant,
        "operation_id": operation_id,
        "kind": "DESCRIBE_SUBMAP",
        "state": "QUEUED",
        "subject": "maps/town",
        "payload": {"map_id": "town", "session_id": "monday", "submap_id": "a"},
        "attempts": 0,
        "max_attempts": 3,
        "created_at_ns": 1,
    }
    return JobRecord(**{**values, **fields})


def anywhere(uow) -> VectorFilter:
    """A filter of the index, as it is read, that lets everything through."""
    return VectorFilter()
