"""Ambiguous loops beside a broken step of odometry that a version of the map has mended, and where they lie.

Across such a step right loops contradict each other, so that acceptance believes none of those nearby. Once many loops
farther away have shown the step, a loop is tested again whose pose is that of the map on one side of it, carried by
odometry from the submap up to which loops hold (docs/decisions/0095).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from revisit.core.acceptance import Doubt
from revisit.core.acceptance.neighbour_support import NeighbourLoop, agrees
from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.pose_graph.faults import FaultKind
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.records import LoopRecord, MapRecord, SubmapRecord
from revisit.service.features.graph.map_frames import MapFrames
from revisit.service.ports.map_optimiser import FAULTS
from revisit.service.ports.transactions import UnitOfWork

_BY_OTHERS = frozenset({Doubt.PAIRWISE_INCONSISTENT, Doubt.SUPPORT_LOST})
"""Doubts that loops raise which lie across a broken step."""

_MOST_READ = 2000


@dataclass(frozen=True)
class _Side:
    """The submap at one end of a fault, and where the odometry frame of its session lies in the map as of it."""

    submap: SubmapRecord
    frame: str
    T_map_odom: Matrix4


def loops_beside_faults(
    uow: UnitOfWork, record: MapRecord, frames: MapFrames, rules: VerificationConfig
) -> Iterator[tuple[LoopRecord, Matrix4]]:
    """The ambiguous loops of a map that agree with one side of a mended step, and T_match_query (4, 4) by that side."""
    sides = _sides(uow, record, frames)
    loops = uow.loops.numbered(record.tenant, _ambiguous(uow, record, {one.submap.session_id for one in sides}))
    numbers = {number for loop in loops.values() for number in (loop.query_number, loop.match_number)}
    submaps = uow.submaps.numbered(record.tenant, sorted(numbers))
    for loop in loops.values():
        query, match = submaps.get(loop.query_number), submaps.get(loop.match_number)
        if loop.T_match_query is None or query is None or match is None or not _is_doubted_by_others(loop):
            continue
        T_match_query = _agreeing(pose_matrix(loop.T_match_query), query, match, sides, frames, rules)
        if T_match_query is not None:
            yield loop, T_match_query


def _is_doubted_by_others(loop: LoopRecord) -> bool:
    """Whether nothing but other loops speaks against an ambiguous one."""
    doubts = loop.evidence.get("doubts", {}).keys()
    return bool(doubts) and doubts <= _BY_OTHERS


def _ambiguous(uow: UnitOfWork, record: MapRecord, sessions: set[str]) -> list[int]:
    """The numbers of the ambiguous loops with an end in one of the sessions, at most `_MOST_READ`."""
    found, after = list[int](), 0
    while sessions and len(found) < _MOST_READ:
        page = uow.loops.rejected(record.tenant, record.map_id, ["AMBIGUOUS"], after=after, limit=_MOST_READ)
        found += [one.number for one in page if sessions & {one.query_session_id, one.match_session_id}]
        if len(page) < _MOST_READ:
            break
        after = page[-1].number
    return found[:_MOST_READ]


def _sides(uow: UnitOfWork, record: MapRecord, frames: MapFrames) -> list[_Side]:
    """Both ends of each broken step that the version in force has mended."""
    version = uow.map_versions.get(record.tenant, record.map_id, record.map_version)
    faults = [] if version is None else version.summary.get(FAULTS, [])
    broken = [fault for fault in faults if FaultKind(fault["kind"]).is_at_once]
    numbers = [fault[end] for fault in broken for end in ("first_number", "last_number")]
    known = uow.submaps.numbered(record.tenant, sorted(set(numbers))) if numbers else {}
    sides = []
    for submap in known.values():
        if (pose := frames.submap(submap)) is not None:
            T_map_odom = pose_matrix(pose.T_map) @ se3.inverse(pose_matrix(submap.T_odom_submap))
            sides.append(_Side(submap, pose.frame, T_map_odom))
    return sides


def _agreeing(
    T_match_query: Matrix4,
    query: SubmapRecord,
    match: SubmapRecord,
    sides: list[_Side],
    frames: MapFrames,
    rules: VerificationConfig,
) -> Matrix4 | None:
    """The pose of the nearest side of a step that says `T_match_query`, too; None where none does."""
    found = list[tuple[float, Matrix4]]()
    for side in sides:
        for end, other in ((query, match), (match, query)):
            way_m = _apart_m(end, side.submap)
            known = frames.submap(other)
            if _drive(end) != _drive(side.submap) or way_m > rules.support_reach or known is None:
                continue
            T_map_end, T_map_other = side.T_map_odom @ pose_matrix(end.T_odom_submap), pose_matrix(known.T_map)
            T_other_end = se3.inverse(T_map_other) @ T_map_end
            said = T_other_end if end is query else se3.inverse(T_other_end)
            if known.frame == side.frame and agrees(
                T_match_query, NeighbourLoop(True, (said,), 0.0, 0.0, way_m), rules
            ):
                found.append((way_m, said))
    return min(found, key=lambda one: one[0])[1] if found else None


def _drive(submap: SubmapRecord) -> SessionKey:
    return SessionKey(submap.map_id, submap.session_id)


def _apart_m(one: SubmapRecord, other: SubmapRecord) -> float:
    apart = np.subtract(pose_matrix(one.T_odom_submap)[:3, 3], pose_matrix(other.T_odom_submap)[:3, 3])
    return float(np.linalg.norm(apart))
