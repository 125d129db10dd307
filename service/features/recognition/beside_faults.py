"""Ambiguous loops beside a broken step of odometry that a version of the map has mended, and where they lie.

Across such a step right loops contradict each other, so that acceptance believes none of those nearby. Once many loops
farther away have shown the step, a loop is tested again whose pose is that of the map on one side of it, carried by
odometry from the submap up to which loops hold (docs/decisions/0095).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from revisit.core.acceptance.neighbour_support import NeighbourLoop, agrees
from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.pose_graph.faults import FaultKind
from revisit.service.domain.records import LoopRecord, MapRecord, SubmapRecord
from revisit.service.features.graph.doubted_loops import LOOPS_AT_ONCE, is_doubted_by_others
from revisit.service.features.graph.map_frames import MapFrames
from revisit.service.ports.map_optimiser import FAULTS
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class _Side:
    """The submap at one end of a fault, and where the odometry frame of its session lies in the map as of it.

    That holds between the submaps `after` and `before`, ordinals of the drive: beyond these lies another step.
    """

    submap: SubmapRecord
    frame: str
    T_map_odom: Matrix4
    after: float
    before: float

    def holds_at(self, end: SubmapRecord) -> bool:
        """Whether no broken step lies between this submap and `end`, of the same drive."""
        return end.key.session == self.submap.key.session and self.after < end.ordinal < self.before


class MendedSteps:
    """The sides of the broken steps that a version of a map has mended, read once for all pages of loops."""

    def __init__(self) -> None:
        """Of no version yet."""
        self._of: dict[tuple[int, int], list[_Side]] = {}

    def sides(self, uow: UnitOfWork, record: MapRecord, frames: MapFrames) -> list[_Side]:
        """Both ends of each step of the version in force by `record`."""
        version = record.number, record.map_version
        if version not in self._of:
            self._of[version] = _sides(uow, record, frames)
        return self._of[version]


def loops_beside_faults(
    uow: UnitOfWork, record: MapRecord, frames: MapFrames, rules: VerificationConfig, steps: MendedSteps, after: int
) -> tuple[list[tuple[LoopRecord, Matrix4]], int | None]:
    """The ambiguous loops of a map that agree with one side of a mended step, and T_match_query (4, 4) by that side.

    Of a page of loops numbered above `after`; and where the next page begins, None after the last.
    """
    sides = steps.sides(uow, record, frames)
    if not sides:
        return [], None
    page = uow.loops.rejected(record.tenant, record.map_id, ["AMBIGUOUS"], after=after, limit=LOOPS_AT_ONCE)
    sessions = {one.submap.session_id for one in sides}
    beside = [one.number for one in page if sessions & {one.query_session_id, one.match_session_id}]
    loops = [one for one in uow.loops.numbered(record.tenant, beside).values() if is_doubted_by_others(one)]
    numbers = {number for loop in loops for number in (loop.query_number, loop.match_number)}
    submaps = uow.submaps.numbered(record.tenant, sorted(numbers))
    found = []
    for loop in loops:
        query, match = submaps.get(loop.query_number), submaps.get(loop.match_number)
        if loop.T_match_query is None or query is None or match is None:
            continue
        T_match_query = _agreeing(pose_matrix(loop.T_match_query), query, match, sides, frames, rules)
        if T_match_query is not None:
            found.append((loop, T_match_query))
    return found, page[-1].number if len(page) == LOOPS_AT_ONCE else None


def _sides(uow: UnitOfWork, record: MapRecord, frames: MapFrames) -> list[_Side]:
    """Both ends of each broken step that the version in force has mended."""
    version = uow.map_versions.get(record.tenant, record.map_id, record.map_version)
    faults = [] if version is None else version.summary.get(FAULTS, [])
    broken = [fault for fault in faults if FaultKind(fault["kind"]).is_at_once and not fault.get("undecided")]
    numbers = [fault[end] for fault in broken for end in ("first_number", "last_number")]
    known = uow.submaps.numbered(record.tenant, sorted(set(numbers))) if numbers else {}
    ends = [(known.get(fault["first_number"]), known.get(fault["last_number"])) for fault in broken]
    steps = [(first, last) for first, last in ends if first is not None and last is not None]
    sides = []
    for submap in known.values():
        if (pose := frames.submap(submap)) is not None:
            T_map_odom = pose_matrix(pose.T_map) @ se3.inverse(pose_matrix(submap.T_odom_submap))
            sides.append(_Side(submap, pose.frame, T_map_odom, *_until_next(submap, steps)))
    return sides


def _until_next(submap: SubmapRecord, steps: list[tuple[SubmapRecord, SubmapRecord]]) -> tuple[float, float]:
    """The ordinals of the far ends of the steps before and behind a submap of the same drive, infinite without one."""
    of_drive = [step for step in steps if step[0].key.session == submap.key.session]
    after = max((first.ordinal for first, last in of_drive if last.ordinal <= submap.ordinal), default=-math.inf)
    before = min((last.ordinal for first, last in of_drive if first.ordinal >= submap.ordinal), default=math.inf)
    return after, before


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
            if not side.holds_at(end) or way_m > rules.support_reach or known is None:
                continue
            T_map_end, T_map_other = side.T_map_odom @ pose_matrix(end.T_odom_submap), pose_matrix(known.T_map)
            T_other_end = se3.inverse(T_map_other) @ T_map_end
            said = T_other_end if end is query else se3.inverse(T_other_end)
            if known.frame == side.frame and agrees(
                T_match_query, NeighbourLoop(True, (said,), 0.0, 0.0, way_m), rules
            ):
                found.append((way_m, said))
    return min(found, key=lambda one: one[0])[1] if found else None


def _apart_m(one: SubmapRecord, other: SubmapRecord) -> float:
    apart = np.subtract(pose_matrix(one.T_odom_submap)[:3, 3], pose_matrix(other.T_odom_submap)[:3, 3])
    return float(np.linalg.norm(apart))
