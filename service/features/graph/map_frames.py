"""Poses of submaps and sessions in the map, by its version in force."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from revisit.core.geometry.se3 import Matrix4, pose_matrix, pose_row
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import LoopRecord, MapRecord, Pose, SessionPosesRecord, SubmapRecord
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.ports.repositories import FoundSubmap, LoopEnds
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class MapPose:
    """A pose in a frame of the map, 16 floats, row-major, by a version of the map."""

    T_map: Pose
    frame: str
    map_version: int

    def of_child(self, T_parent_child: Matrix4) -> MapPose:
        """The pose of a child at `T_parent_child` (4, 4) in this frame."""
        return MapPose(pose_row(pose_matrix(self.T_map) @ T_parent_child), self.frame, self.map_version)


@dataclass(frozen=True)
class LoopInMap:
    """The two submaps of a loop, where they share a frame of the map."""

    query: MapPose
    match: MapPose


@dataclass(frozen=True)
class _SessionInMap:
    frame: str
    T_map_odom: Matrix4
    submaps: PackedSubmaps

    @classmethod
    def of(cls, row: SessionPosesRecord) -> _SessionInMap:
        return cls(row.frame, pose_matrix(row.T_map_odom), PackedSubmaps.of(row.submaps))


class KeptSessions:
    """A cache of the poses of sessions by version: 280 bytes a submap, of which an answer needs few.

    A version does not change but for submaps that are deleted, and nobody asks for those. The number of a row is never
    used twice.
    """

    def __init__(self, most_submaps: int = 100_000) -> None:
        """Those least lately asked for go first."""
        self._most = most_submaps
        self._count = 0
        self._rows: OrderedDict[tuple[TenantId, str, int, str], tuple[int, _SessionInMap]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, numbers: Collection[int], *of: *tuple[TenantId, str, int, str]) -> _SessionInMap | None:
        """The cached poses of a tenant's map, version and session, if its row is still one of those `numbers`."""
        with self._lock:
            number, session = self._rows.get(of, (0, None))
            if number not in numbers:
                return None
            self._rows.move_to_end(of)
            return session

    def keep(self, row: SessionPosesRecord, session: _SessionInMap) -> None:
        """Keep the poses of the row."""
        of = row.tenant, row.map_id, row.version, row.session_id
        with self._lock:
            if of in self._rows:
                self._count -= len(self._rows.pop(of)[1].submaps.numbers)
            self._rows[of] = row.number, session
            self._count += len(session.submaps.numbers)
            while self._count > self._most:
                self._count -= len(self._rows.popitem(last=False)[1][1].submaps.numbers)


class MapFrames:
    """The poses of one map, read within one transaction as they are asked for."""

    def __init__(
        self,
        uow: UnitOfWork,
        tenant: TenantId,
        map_id: str,
        kept: KeptSessions | None = None,
        record: MapRecord | None = None,
    ) -> None:
        """Those of the version in force; of none where the map has none, or is not there. Sessions may be `kept`. The
        map's `record` may have been read before: then those of the version that was in force by it.
        """
        record = record or uow.maps.get(tenant, map_id)
        self._uow = uow
        self._tenant = tenant
        self._map_id = map_id
        self._version = 0 if record is None else record.map_version
        self._kept = kept
        self._numbers: Collection[int] | None = None
        self._sessions: dict[str, _SessionInMap | None] = {}

    def submaps(self, found: Mapping[int, FoundSubmap]) -> dict[int, MapPose]:
        """As `submap`, of those by number that have a frame."""
        return self._poses({number: submap.session_id for number, submap in found.items()}) if self._version else {}

    def submap(self, record: SubmapRecord) -> MapPose | None:
        """T_map_submap; of a submap that came after the version by its session's correction. None without a frame."""
        known = self._known(record.session_id, record.number)
        if known is not None:
            return known
        session = self._session(record.session_id)
        if session is None:
            return None
        T_map_submap = session.T_map_odom @ pose_matrix(record.T_odom_submap)
        return MapPose(pose_row(T_map_submap), session.frame, self._version)

    def loops(self, records: Iterable[LoopRecord | LoopEnds]) -> dict[int, LoopInMap]:
        """The ends of the loops, by number, with both submaps in one frame."""
        if not self._version:
            return {}
        records = list(records)
        sessions = {loop.query_number: loop.query_session_id for loop in records}
        poses = self._poses(sessions | {loop.match_number: loop.match_session_id for loop in records})
        ends = {loop.number: (poses.get(loop.query_number), poses.get(loop.match_number)) for loop in records}
        return {
            number: LoopInMap(query, match)
            for number, (query, match) in ends.items()
            if query is not None and match is not None and query.frame == match.frame
        }

    def spread_m(self, loop: LoopRecord) -> float | None:
        """How well the version knows where the ends of a loop lie to each other: one standard deviation, metres.

        Across the ground, at most: that the errors of the two ends have much in common does not count. None where the
        version does not have them.
        """
        variance = 0.0
        for session_id, number in (
            (loop.query_session_id, loop.query_number),
            (loop.match_session_id, loop.match_number),
        ):
            session = self._session(session_id)
            place = None if session is None else session.submaps.place_of(number)
            if session is None or place is None:
                return None
            level = session.submaps.T_map_submap[place, :2, :3]  # rows that lead to x and y of the map
            across = level @ session.submaps.covariances[place, :3, :3].astype(np.float64) @ level.T
            variance += float(np.linalg.eigvalsh(across)[-1])
        return float(np.sqrt(max(variance, 0.0)))

    def _poses(self, sessions: Mapping[int, str]) -> dict[int, MapPose]:
        """The poses of submaps by number, of which `sessions` gives the session.

        Rows are read only of submaps that are not in the version, with a session that is.
        """
        known = {number: self._known(session_id, number) for number, session_id in sessions.items()}
        missing = sorted(
            number for number, pose in known.items() if pose is None and self._session(sessions[number]) is not None
        )
        later = self._uow.submaps.numbered(self._tenant, missing) if missing else {}
        poses = known | {number: self.submap(record) for number, record in later.items()}
        return {number: pose for number, pose in poses.items() if pose is not None}

    def _known(self, session_id: str, number: int) -> MapPose | None:
        session = self._session(session_id)
        place = None if session is None else session.submaps.place_of(number)
        if session is None or place is None:
            return None
        return MapPose(pose_row(session.submaps.T_map_submap[place]), session.frame, self._version)

    def _session(self, session_id: str) -> _SessionInMap | None:
        if not self._version:
            return None
        if session_id not in self._sessions:
            self._sessions[session_id] = self._read(session_id)
        return self._sessions[session_id]

    def _read(self, session_id: str) -> _SessionInMap | None:
        of = self._tenant, self._map_id, self._version, session_id
        kept = None if self._kept is None else self._kept.get(self._rows(), *of)
        if kept is not None:
            return kept
        row = self._uow.session_poses.get(*of)
        if row is None:
            return None
        session = _SessionInMap.of(row)
        if self._kept is not None:
            self._kept.keep(row, session)
        return session

    def _rows(self) -> Collection[int]:
        """The numbers of the rows of the version, without their content."""
        if self._numbers is None:
            rows = self._uow.session_poses
            self._numbers = rows.distinct(self._tenant, "number", map_id=self._map_id, version=self._version)
        return self._numbers


def frame_name(session_number: int) -> str:
    """The frame of the map that is the odometry frame of this session: its oldest one."""
    return f"frame-{session_number}"


def submap_in_map(uow: UnitOfWork, record: SubmapRecord) -> MapPose | None:
    """T_map_submap of one submap (see `MapFrames.submap`)."""
    return MapFrames(uow, record.tenant, record.map_id).submap(record)


def matrix_of(pose: MapPose | None) -> Matrix4 | None:
    """The (4, 4) transform of a pose in the map."""
    return None if pose is None else np.array(pose_matrix(pose.T_map))
