"""The transaction that stores a version of a map: poses, verdicts on loops and the end of the job, together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import pose_row
from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.events import EventRecord
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import LoopRecord, MapRecord, MapVersionRecord, SessionPosesRecord
from revisit.service.domain.states import AnchorKind, EventKind, LoopEventKind
from revisit.service.failpoints import failpoint
from revisit.service.features.deletion.blob_references import forget_tiles
from revisit.service.features.graph.anchor_verdicts import changed_anchors, pack_anchors
from revisit.service.features.graph.anchors import stored_frames
from revisit.service.features.graph.map_frames import frame_name
from revisit.service.features.graph.map_jobs import recall_loops
from revisit.service.features.graph.odometry_faults import stored_faults
from revisit.service.features.graph.reading import MapTask
from revisit.service.features.graph.session_poses import (
    PackedSubmaps,
    hash_of_loops,
    hash_of_session,
    pack_loops,
)
from revisit.service.features.graph.told_changes import find_changes_soon
from revisit.service.features.loops.rows import Change, change_loops
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.map_optimiser import (
    AUDITED,
    FAULTS,
    GEOREFERENCES,
    REFUSED_JOINS,
    JudgedLoop,
    OptimisedMap,
    OptimisedTrack,
    RefusedJoin,
)
from revisit.service.ports.transactions import UnitOfWork

MAP_DELETED = {"outcome": "the map was deleted"}
MAP_REVERTED = {"outcome": "an earlier version was brought back meanwhile"}
"""Results of a job for a map that is gone, or that a person has fixed."""

TOLD_ANCHORS = 1000
"""Anchors at most of which a version tells by events."""


@dataclass(frozen=True)
class VersionCommit:
    """The one transaction that ends an optimisation; it keeps as many versions as the policy says."""

    lease: Lease
    task: MapTask
    optimised: OptimisedMap
    policy: Policy
    now_ns: int

    def __call__(self, uow: UnitOfWork) -> bool:
        """Commit, or change nothing and return False where the graph has lost or changed a part since it was read.

        Raises StaleLease where another worker holds the job.
        """
        known = self.task.map
        current = uow.maps.get(known.tenant, known.map_id, hold=True)
        uow.queue.require(self.lease)
        if current is None or current.number != known.number:
            self._end(uow, MAP_DELETED)
        elif current.map_version != known.map_version and _was_restored(uow, current):
            self._end(uow, MAP_REVERTED)
        elif (current.map_version, current.graph_edits) != (known.map_version, known.graph_edits):
            return False
        else:
            self._store(uow, current)
        return True

    def _store(self, uow: UnitOfWork, current: MapRecord) -> None:
        summary = summary_of(self.task, self.optimised.tracks, self.optimised)
        operation_id = self.lease.job.operation_id
        version = add_version(uow, current, self.task, self.optimised, summary, operation_id, self.now_ns)
        forget_versions(uow, current.tenant, current.map_id, version - self.policy.map_versions_kept)
        recall_loops(uow, current.tenant, current.map_id, self.policy, self.now_ns)
        find_changes_soon(uow, current.tenant, current.map_id, self.policy, self.now_ns)
        details = {name: its for name, its in summary.items() if name not in (AUDITED, FAULTS, GEOREFERENCES)}
        self._end(uow, {"version": f"maps/{current.map_id}/versions/{version}", **details})

    def _end(self, uow: UnitOfWork, result: dict[str, Any]) -> None:
        uow.queue.complete(self.lease, result)


def add_version(
    uow: UnitOfWork,
    current: MapRecord,
    task: MapTask,
    optimised: OptimisedMap,
    summary: dict[str, Any],
    operation_id: str,
    now_ns: int,
) -> int:
    """Store the poses of a task's tracks and the verdicts on its loops as the version in force; its number."""
    version, packed, fixed = current.map_version + 1, pack_loops(optimised.loops), pack_anchors(optimised.anchors)
    uow.map_versions.add(
        MapVersionRecord(
            tenant=current.tenant,
            map_id=current.map_id,
            version=version,
            restored_from=None,
            operation_id=operation_id,
            summary=summary,
            loops=packed,
            loops_hash=hash_of_loops(packed),
            created_at_ns=now_ns,
            anchors=fixed,
        )
    )
    tell_anchors(uow, current, fixed)
    failpoint("optimise.after_version")
    for row in _poses(current, task, optimised.tracks, version, now_ns):
        uow.session_poses.add(row)
    judge_loops(uow, task.loops, optimised.loops, version, now_ns)
    failpoint("optimise.after_poses")
    uow.maps.replace(replace(current, map_version=version))
    return version


def _poses(
    current: MapRecord, task: MapTask, tracks: Iterable[OptimisedTrack], version: int, now_ns: int
) -> Iterable[SessionPosesRecord]:
    for session_id, track, solved in zip(task.session_ids, task.graph.tracks, tracks, strict=True):
        numbers = np.array(track.submaps, dtype=np.int64)
        data = PackedSubmaps(numbers, solved.T_map_submap, solved.covariances.astype(np.float32)).packed()
        frame = frame_name(solved.anchor)
        yield SessionPosesRecord(
            tenant=current.tenant,
            map_id=current.map_id,
            version=version,
            session_id=session_id,
            session_number=track.session_number,
            frame=frame,
            T_map_odom=pose_row(solved.T_map_odom),
            submaps=data,
            content_hash=hash_of_session(track.session_number, frame, solved.T_map_odom, data),
            created_at_ns=now_ns,
        )


def judge_loops(
    uow: UnitOfWork, loops: Iterable[LoopRecord], judged: Iterable[JudgedLoop], version: int, now_ns: int
) -> None:
    """Store a version's verdicts on loops; a loop that it leaves out has no verdict of the graph."""
    verdicts = {verdict.number: verdict for verdict in judged}
    changes: dict[str | None, list[tuple[LoopRecord, Change]]] = {}
    for loop in loops:
        verdict = verdicts.get(loop.number)
        state = None if verdict is None else verdict.state.value
        if state == loop.graph_state:
            continue
        distance = np.nan if verdict is None else verdict.squared_distance
        details: dict[str, Any] = {"squared_distance": float(distance)} if np.isfinite(distance) else {}
        if verdict is not None and verdict.refusal is not None:
            details["refusal"] = verdict.refusal
        change = Change(LoopEventKind.JUDGED, now_ns, map_version=version, details=details)
        changes.setdefault(state, []).append((loop, change))
    for state, some in changes.items():
        change_loops(uow, some, state)


def tell_anchors(uow: UnitOfWork, current: MapRecord, after: bytes | None) -> None:
    """Record the anchors on which the next version of a map has another verdict than the one in force, as events.

    That one is set aside, or no longer is. That one holds the map, or no longer does, where it is no fix: of these
    there are thousands, and the version tells how many hold. At most TOLD_ANCHORS, fixes last: the transaction holds up
    all other writers.
    """
    version = uow.map_versions.get(current.tenant, current.map_id, current.map_version)
    aside, held = changed_anchors(None if version is None else version.anchors, after)
    surveyed = set[int]()
    for kind in (AnchorKind.CONTROL_POINT, AnchorKind.KNOWN_POSE) if aside | held else ():
        surveyed |= uow.anchors.distinct(current.tenant, "number", map_id=current.map_id, kind=kind.value)
    told = sorted((aside | held) & surveyed) + sorted(aside - surveyed)
    for number in sorted(told[:TOLD_ANCHORS]):
        uow.events.record(EventRecord(current.tenant, current.map_id, EventKind.ANCHOR.value, str(number)))


def forget_versions(uow: UnitOfWork, tenant: TenantId, map_id: str, last: int) -> None:
    """Delete the versions of a map up to number `last`, with the operations that made them.

    Those that stay which a merge leads back to.
    """
    pinned = uow.map_merges.distinct(tenant, "version_before", map_id=map_id, reverted_at_ns=None)
    for version in sorted(uow.map_versions.distinct(tenant, "version", map_id=map_id) - pinned):
        if version > last:
            return
        of_version: dict[str, str | int] = {"map_id": map_id, "version": version}
        for operation_id in uow.map_versions.distinct(tenant, "operation_id", **of_version):
            uow.jobs.delete(tenant, operation_id=operation_id)
        forget_tiles(uow, tenant, map_id, version)
        uow.session_poses.delete(tenant, **of_version)
        uow.map_versions.delete(tenant, **of_version)


def summary_of(task: MapTask, tracks: Sequence[OptimisedTrack], optimised: OptimisedMap) -> dict[str, Any]:
    """The evidence of a version, and how far it moved the submaps: the fields of a MapVersionSummary, and FAULTS where
    there are any.

    `tracks` are those of the task's tracks, in their order.
    """
    states = Counter(loop.state for loop in optimised.loops)
    changes = _changes_m(task, tracks)
    return {
        "sessions": len(tracks),
        "submaps": sum(len(track.submaps) for track in task.graph.tracks),
        "frames": len({track.anchor for track in tracks}),
        "loops_in_map": states[GraphState.IN_MAP],
        "loops_set_aside": states[GraphState.SET_ASIDE],
        "loops_unconnected": states[GraphState.UNCONNECTED],
        "chi2": float(optimised.chi2),
        "degrees_of_freedom": optimised.degrees_of_freedom,
        "mean_change_m": float(changes.mean()) if len(changes) else None,
        "max_change_m": float(changes.max()) if len(changes) else None,
        **({FAULTS: stored_faults(task, optimised.faults)} if optimised.faults else {}),
        **({AUDITED: {str(one): count for one, count in optimised.audited.items()}} if optimised.audited else {}),
        **({GEOREFERENCES: stored_frames(optimised.on_earth, task.session_names)} if optimised.on_earth else {}),
        **({REFUSED_JOINS: [_stored(task, one) for one in optimised.refused_joins]} if optimised.refused_joins else {}),
    }


def _stored(task: MapTask, join: RefusedJoin) -> dict[str, Any]:
    """The fields of a RefusedJoin of the API."""
    known = task.session_names

    def names(numbers: Iterable[int]) -> list[str]:
        return [known[number] for number in numbers]

    found = join.evidence
    measured = {"residual_m": found.residual_m} if np.isfinite(found.residual_m) else {}
    return {
        "sessions": names(join.sessions),
        "other_sessions": names(join.others),
        "reason": join.reason.value,
        "loops": join.loops,
        "common_points": found.common_points,
        "seen_through_share": found.seen_through_share,
        "worst_stretch_share": found.worst_stretch_share,
        **measured,
    }


def _changes_m(task: MapTask, tracks: Iterable[OptimisedTrack]) -> NDArray[np.float64]:
    """How far each submap moved that the version before has in the same frame, metres."""
    before = {row.session_number: row for row in task.before}
    moved = [np.empty(0)]
    for track, solved in zip(task.graph.tracks, tracks, strict=True):
        row = before.get(track.session_number)
        if row is not None and row.frame == frame_name(solved.anchor):
            old = PackedSubmaps.of(row.submaps)
            _, here, there = np.intersect1d(track.submaps, old.numbers, return_indices=True)
            moved.append(np.linalg.norm(solved.T_map_submap[here, :3, 3] - old.T_map_submap[there, :3, 3], axis=1))
    return np.concatenate(moved)


def _was_restored(uow: UnitOfWork, record: MapRecord) -> bool:
    version = uow.map_versions.get(record.tenant, record.map_id, record.map_version)
    return version is not None and version.restored_from is not None
