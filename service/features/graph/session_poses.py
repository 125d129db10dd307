"""The poses of a version of a map, and its verdicts on loops, packed into bytes: the same content, the same bytes."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4
from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.records import MapVersionRecord
from revisit.service.features.graph.anchor_verdicts import hash_of_anchors, kept_anchors
from revisit.service.features.graph.packed_rows import packed_rows
from revisit.service.ports.map_optimiser import FAULTS, GEOREFERENCES, REFUSED_JOINS, SESSIONS, JudgedLoop
from revisit.service.ports.transactions import UnitOfWork

_SUBMAP = np.dtype([("number", "<i8"), ("T_map_submap", "<f8", (4, 4)), ("covariance", "<f4", (6, 6))])
_LOOP = np.dtype([("number", "<i8"), ("state", "u1"), ("squared_distance", "<f8")])
_STATES = (GraphState.IN_MAP, GraphState.SET_ASIDE, GraphState.UNCONNECTED)
LOOPS_IN_SUMMARY = ("loops_in_map", "loops_set_aside", "loops_unconnected")
"""Where the summary of a version counts the loops of each state, in the same order."""


@dataclass(frozen=True)
class PackedSubmaps:
    """Submaps of a session in the order of the drive: numbers (n,), T_map_submap (n, 4, 4), covariances (n, 6, 6)."""

    numbers: NDArray[np.int64]
    T_map_submap: NDArray[np.float64]
    covariances: NDArray[np.float32]

    @classmethod
    def of(cls, data: bytes) -> PackedSubmaps:
        """The inverse of `packed`; views of `data`, but for the numbers, which are sought. Raises DataLoss."""
        rows = packed_rows(data, _SUBMAP)
        return cls(rows["number"].copy(), rows["T_map_submap"], rows["covariance"])

    def packed(self) -> bytes:
        """As bytes."""
        rows = np.empty(len(self.numbers), _SUBMAP)
        rows["number"], rows["T_map_submap"], rows["covariance"] = self.numbers, self.T_map_submap, self.covariances
        return rows.tobytes()

    def place_of(self, number: int) -> int | None:
        """Where in the drive the submap of this number is, None where it is not there."""
        found = np.flatnonzero(self.numbers == number)
        return int(found[0]) if len(found) else None

    def without(self, doomed: Collection[int]) -> PackedSubmaps:
        """Without the submaps of these numbers."""
        kept = ~np.isin(self.numbers, list(doomed))
        return PackedSubmaps(self.numbers[kept], self.T_map_submap[kept], self.covariances[kept])


def pack_loops(loops: Sequence[JudgedLoop]) -> bytes:
    """The verdicts on loops as bytes."""
    rows = np.empty(len(loops), _LOOP)
    rows["number"] = [loop.number for loop in loops]
    rows["state"] = [_STATES.index(loop.state) for loop in loops]
    rows["squared_distance"] = [loop.squared_distance for loop in loops]
    return rows.tobytes()


def unpack_loops(data: bytes) -> list[JudgedLoop]:
    """The inverse of `pack_loops`. Raises DataLoss."""
    rows = packed_rows(data, _LOOP, state=len(_STATES))
    values = zip(rows["number"].tolist(), rows["state"].tolist(), rows["squared_distance"].tolist(), strict=True)
    return [JudgedLoop(number, _STATES[state], distance) for number, state, distance in values]


def hash_of_loops(data: bytes) -> str:
    """SHA-256 (hex) of packed verdicts."""
    return hashlib.sha256(data).hexdigest()


def hash_of_session(session_number: int, frame: str, T_map_odom: Matrix4, submaps: bytes) -> str:
    """SHA-256 (hex) of a session's poses in a version."""
    digest = hashlib.sha256(f"{session_number}:{frame}:{len(submaps)}:".encode())
    digest.update(np.asarray(T_map_odom, dtype="<f8").tobytes())
    digest.update(submaps)
    return digest.hexdigest()


def hash_of_version(record: MapVersionRecord, sessions: Iterable[str]) -> str:
    """SHA-256 (hex) of a version: of its verdicts and of its sessions' hashes, in any order, and of its anchors."""
    parts = [record.loops_hash, *sorted(sessions), *hash_of_anchors(record)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def forget_submap(uow: UnitOfWork, tenant: TenantId, map_id: str, session_id: str, number: int) -> None:
    """Take a submap, whose loops are gone, out of every version of the map."""
    forgotten: Counter[int] = Counter()
    for row in uow.session_poses.find(tenant, map_id=map_id, session_id=session_id):
        known = PackedSubmaps.of(row.submaps)
        left = known.without([number])
        forgotten[row.version] += len(known.numbers) - len(left.numbers)
        if not len(left.numbers):
            uow.session_poses.delete(tenant, number=row.number)
            continue
        data = left.packed()
        T_map_odom = np.asarray(row.T_map_odom).reshape(4, 4)
        content_hash = hash_of_session(row.session_number, row.frame, T_map_odom, data)
        uow.session_poses.replace(replace(row, submaps=data, content_hash=content_hash))
    forget_in_summaries(uow, tenant, map_id, forgotten)


def _of_sessions(summary: Mapping[str, Any], sessions: Collection[str], frames: Collection[str]) -> dict[str, Any]:
    """The refused joins and faults of odometry of a summary, if there are any, of the sessions of these names; and of
    frames of these names where they lie on earth.
    """
    sides = ("sessions", "other_sessions")
    joins = [
        {**join, **{side: [name for name in join[side] if name in sessions] for side in sides}}
        for join in summary.get(REFUSED_JOINS, ())
    ]
    left = {
        REFUSED_JOINS: [join for join in joins if all(join[side] for side in sides)],
        FAULTS: [fault for fault in summary.get(FAULTS, ()) if fault["session"] in sessions],
        GEOREFERENCES: [_frame_of(one, sessions) for one in summary.get(GEOREFERENCES, ()) if one["frame"] in frames],
    }
    return {name: its for name, its in left.items() if name in summary}


def _frame_of(frame: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """A frame on earth that tells of sessions of these names alone."""
    told = [one for one in frame.get(SESSIONS, ()) if one["session"] in names]
    left = {name: its for name, its in frame.items() if name != SESSIONS}
    return {**left, SESSIONS: told} if told else left


def forget_in_summaries(uow: UnitOfWork, tenant: TenantId, map_id: str, submaps: Mapping[int, int]) -> None:
    """Take loops that are gone out of some versions, and out of their summaries; `submaps` gone, by version."""
    held = np.array(sorted(uow.loops.distinct(tenant, "number", map_id=map_id)), dtype=np.int64)
    anchors = uow.anchors.distinct(tenant, "number", map_id=map_id)
    for version in sorted(number for number, gone in submaps.items() if gone):
        row = uow.map_versions.get(tenant, map_id, version)
        if row is None:
            continue
        of_version: dict[str, str | int] = {"map_id": map_id, "version": version}
        verdicts = packed_rows(row.loops, _LOOP, state=len(_STATES))
        verdicts = verdicts[np.isin(verdicts["number"], held)]
        loops = dict(
            zip(LOOPS_IN_SUMMARY, np.bincount(verdicts["state"], minlength=len(_STATES)).tolist(), strict=True)
        )
        sessions = uow.session_poses.distinct(tenant, "session_id", **of_version)
        frames = uow.session_poses.distinct(tenant, "frame", **of_version)
        summary = {
            **row.summary,
            **loops,
            **_of_sessions(row.summary, {SessionKey(map_id, one).name for one in sessions}, frames),
            "sessions": len(sessions),
            "frames": len(frames),
            "submaps": row.summary["submaps"] - submaps[version],
        }
        data = verdicts.tobytes()
        left = kept_anchors(row.anchors, anchors)
        uow.map_versions.replace(
            replace(row, summary=summary, loops=data, loops_hash=hash_of_loops(data), anchors=left)
        )
