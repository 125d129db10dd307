"""The pose graph of a map as the database holds it: the drives of its sessions and the accepted loops between them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import pose_matrix
from revisit.core.pose_graph.graph import OdometryModel
from revisit.core.pose_graph.jumps import jumps
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import AnchorRecord, LoopRecord, MapRecord, SessionPosesRecord, SessionRecord
from revisit.service.features.graph.anchors import read_anchors
from revisit.service.ports.map_optimiser import AUDITED, MapGraph, SessionTrack, TrackLoop
from revisit.service.ports.repositories import PlacedSubmap
from revisit.service.ports.transactions import UnitOfWork

_PAGE = 500

_NO_EVIDENCE: dict[str, Any] = {}


@dataclass(frozen=True)
class MapTask:
    """A map to optimise: its pose graph, its loops in the order of the graph's, and its poses by the version in force.

    `session_ids` are those of the tracks. The loops have no evidence: that is five sixths of their bytes. `audited`
    is that of the version in force.
    """

    map: MapRecord
    graph: MapGraph
    session_ids: tuple[str, ...]
    loops: tuple[LoopRecord, ...]
    before: tuple[SessionPosesRecord, ...]
    audited: Mapping[int, int] = field(default_factory=dict)

    @property
    def session_names(self) -> dict[int, str]:
        """The names of the sessions of the tracks, by number."""
        both = zip(self.graph.tracks, self.session_ids, strict=True)
        return {track.session_number: SessionKey(self.map.map_id, name).name for track, name in both}


def read_task(
    uow: UnitOfWork, policy: Policy, tenant: TenantId, map_id: str, more: Sequence[AnchorRecord] = ()
) -> MapTask | None:
    """The map as it is now, with `more` anchors; None where it is gone."""
    record = uow.maps.get(tenant, map_id)
    if record is None:
        return None
    sessions = {session.number: session for session in uow.sessions.find(tenant, map_id=map_id)}
    placed = uow.submaps.placed(tenant, map_id)
    tracks = _tracks(placed, sessions)
    loops, of_graph = _accepted(uow, tenant, map_id)
    fixed = read_anchors(uow, record, placed, more)
    graph = MapGraph(tracks, of_graph, policy.for_map(record).submap.tau, fixed=fixed)
    before = uow.session_poses.find(tenant, map_id=map_id, version=record.map_version)
    version = uow.map_versions.get(tenant, map_id, record.map_version)
    audited = {} if version is None else {int(one): n for one, n in version.summary.get(AUDITED, {}).items()}
    session_ids = tuple(sessions[track.session_number].session_id for track in tracks)
    return MapTask(record, graph, session_ids, loops, tuple(before), audited)


def _accepted(uow: UnitOfWork, tenant: TenantId, map_id: str) -> tuple[tuple[LoopRecord, ...], tuple[TrackLoop, ...]]:
    """The accepted loops of a map, without their evidence, and as a pose graph has them.

    Read page by page: the evidence of a whole map would take more memory than the solution.
    """
    records: list[LoopRecord] = []
    of_graph: list[TrackLoop] = []
    after: int | None = 0
    while after is not None:
        page = uow.loops.measured(tenant, map_id, after=after, limit=_PAGE)
        known = [loop for loop in page if loop.T_match_query is not None]
        records += [replace(loop, evidence=_NO_EVIDENCE) for loop in known]
        of_graph += [track_loop(loop) for loop in known]
        after = page[-1].number if len(page) == _PAGE else None
    return tuple(records), tuple(of_graph)


def with_evidence(uow: UnitOfWork, loops: Sequence[LoopRecord]) -> Iterator[LoopRecord]:
    """The loops of a task with the evidence that they have now, read page by page. All of them must be there still."""
    for start in range(0, len(loops), _PAGE):
        some = loops[start : start + _PAGE]
        stored = uow.loops.numbered(some[0].tenant, [loop.number for loop in some])
        yield from (replace(loop, evidence=stored[loop.number].evidence) for loop in some)


def _tracks(placed: Iterable[PlacedSubmap], sessions: Mapping[int, SessionRecord]) -> tuple[SessionTrack, ...]:
    tracks = []
    for number, of_session in groupby(placed, key=lambda one: one.session_number):
        drive = list(of_session)
        poses = np.stack([pose_matrix(one.T_odom_submap) for one in drive])
        odometry = OdometryModel.stated(sessions[number].drift)
        jumping = jumps(poses, np.array([one.stamp_ns for one in drive], dtype=np.int64))
        tracks.append(SessionTrack(number, tuple(one.number for one in drive), poses, odometry, jumping))
    return tuple(tracks)


def track_loop(record: LoopRecord) -> TrackLoop:
    """An accepted loop as a pose graph has it."""
    T_match_query = pose_matrix(record.T_match_query or ())
    covariance = measured_covariance(record.evidence)
    return TrackLoop(record.number, record.match_number, record.query_number, T_match_query, covariance)


def measured_covariance(evidence: dict[str, Any]) -> NDArray[np.float64] | None:
    """The covariance (6, 6) that verification measured, None where it has none that is finite."""
    measured = np.asarray(evidence.get("measurement", {}).get("covariance", []), dtype=np.float64)
    return measured.reshape(6, 6) if measured.size == 36 and np.isfinite(measured).all() else None
