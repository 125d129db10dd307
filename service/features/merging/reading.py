"""Two maps as the database holds them, read for a merge of the second into the first."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, DescriptorModelMismatch
from revisit.core.geometry import geodesy, se3
from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import LoopRecord, MapRecord, SessionRecord, SubmapRecord
from revisit.service.domain.states import SubmapState
from revisit.service.features.graph.anchors import loops_against
from revisit.service.features.graph.join_audit import loops_between
from revisit.service.features.graph.map_frames import frame_name
from revisit.service.features.graph.reading import MapTask, read_task
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.ports.map_merger import DescribedPlaces
from revisit.service.ports.map_optimiser import MapGraph, RefusedJoin, TrackLoop
from revisit.service.ports.storage import require_descriptor
from revisit.service.ports.transactions import UnitOfWork


def require_comparable(target: MapRecord, source: MapRecord) -> None:
    """Raises DescriptorModelMismatch where two maps were described by different models, BadField at different scales
    or in different profiles.

    A map of which nothing is described yet has no model.
    """
    if target.scene_scale != source.scene_scale:
        raise BadField("maps of different scene scales cannot be merged", field="source")
    if target.profile != source.profile:
        raise BadField(
            f"maps of different profiles cannot be merged: {target.map_id} is {target.profile}, {source.map_id} "
            f"{source.profile}",
            field="source",
        )
    models = {one.model_version for one in (target, source)} - {None}
    if len(models) > 1:
        raise DescriptorModelMismatch(
            f"map {target.map_id} was described by {target.model_version}, {source.map_id} by {source.model_version}"
        )


@dataclass(frozen=True)
class MergeOrder:
    """The request: the payload of a job. `near` is T_map_source, roughly; loops farther from it do not count."""

    map_id: str
    source_map_id: str
    source_session_id: str | None
    validate_only: bool
    near: Matrix4 | None
    radius_m: float | None
    actor: str

    @classmethod
    def of(cls, payload: dict[str, Any]) -> MergeOrder:
        """From the payload of its job."""
        near = payload["T_map_source"]
        return cls(
            map_id=str(payload["map_id"]),
            source_map_id=str(payload["source_map_id"]),
            source_session_id=payload["source_session_id"],
            validate_only=bool(payload["validate_only"]),
            near=None if near is None else np.array(pose_matrix(tuple(near))),
            radius_m=payload["radius_m"],
            actor=str(payload["actor"]),
        )

    @property
    def source(self) -> str:
        """The resource name of the source."""
        whole = f"maps/{self.source_map_id}"
        return whole if self.source_session_id is None else f"{whole}/sessions/{self.source_session_id}"


@dataclass(frozen=True)
class MapSide:
    """One of the two maps: its graph, the sessions of its tracks by number, its described submaps in the order of these
    tracks, and T_map_submap (n, 4, 4) of each in the frame of the oldest session, NaN where it lies in another one.
    `refused` joins within it are none, as surfaces say.
    """

    task: MapTask
    sessions: dict[int, SessionRecord]
    submaps: tuple[SubmapRecord, ...]
    T_map_submap: NDArray[np.float64]
    refused: tuple[RefusedJoin, ...] = ()

    @property
    def refused_loops(self) -> dict[int, str]:
        """Loops within it that count for nothing, by number, each with the reason."""
        graph = self.task.graph
        return loops_against(graph, graph.fixed) | dict(loops_between(self.task, self.refused))

    @property
    def places(self) -> DescribedPlaces:
        """The descriptors, for the search for candidates. Raises DataLoss where one is damaged."""
        rows = [np.frombuffer(require_descriptor(one), dtype="<f4") for one in self.submaps]
        numbers = np.array([one.session_number for one in self.submaps], dtype=np.int64)
        storeys = tuple(self.sessions[one.session_number].storey for one in self.submaps)
        return DescribedPlaces(np.stack(rows) if rows else np.zeros((0, 1), np.float32), numbers, storeys)


@dataclass(frozen=True)
class MergeTask:
    """The map that grows, and the source that joins it."""

    target: MapSide
    source: MapSide

    def against(self, crossing: tuple[TrackLoop, ...]) -> dict[int, str]:
        """The loops between both that their anchors speak against, by number, each with the reason.

        Tags alone where a map has no origin: metres from unknown places say nothing of each other.
        """
        (first, of_first), (second, of_second) = (
            (one.task.graph, one.task.map.origin) for one in (self.target, self.source)
        )
        if not first.fixed or not second.fixed:
            return {}
        both = replace(first, tracks=first.tracks + second.tracks, loops=crossing)
        if of_first is None or of_second is None:
            return loops_against(both, tuple(one for one in (*first.fixed, *second.fixed) if one.tag is not None))
        T_first_second = se3.inverse(geodesy.T_ecef_enu(of_first)) @ geodesy.T_ecef_enu(of_second)
        moved = (replace(one, place_enu=se3.apply(T_first_second, one.place_enu[None])[0]) for one in second.fixed)
        return loops_against(both, (*first.fixed, *moved))

    def graph(self, crossing: tuple[TrackLoop, ...]) -> MapGraph:
        """Both with the loops between them; the map that grows gives the frame, and its anchors hold it."""
        first, second = self.target.task.graph, self.source.task.graph
        anchors = [*sorted(self.target.sessions), *sorted(self.source.sessions)]
        refused = (one.refused_loops for one in (self.target, self.source))
        return replace(
            first,
            tracks=first.tracks + second.tracks,
            loops=first.loops + second.loops + crossing,
            anchors=tuple(anchors),
            refused=dict(chain.from_iterable(one.items() for one in refused)),
        )


def read_merge(uow: UnitOfWork, policy: Policy, tenant: TenantId, order: MergeOrder) -> MergeTask | None:
    """Both maps as they are now, None where one is gone or has no described submap."""
    target = _side(uow, policy, tenant, order.map_id, None, copied=False)
    source = _side(uow, policy, tenant, order.source_map_id, order.source_session_id, copied=True)
    return None if target is None or source is None else MergeTask(target, source)


def _side(
    uow: UnitOfWork, policy: Policy, tenant: TenantId, map_id: str, session_id: str | None, *, copied: bool
) -> MapSide | None:
    """One of both maps. Of submaps to be `copied` only described ones count."""
    task = read_task(uow, policy, tenant, map_id)
    if task is None:
        return None
    equals: dict[str, Any] = {"map_id": map_id} if session_id is None else {"map_id": map_id, "session_id": session_id}
    described = uow.submaps.find(tenant, state=SubmapState.DESCRIBED.value, **equals)
    by_number = {one.number: one for one in described}
    kept = _only(task, set(by_number)) if copied else task
    placed = [
        (by_number[number], T_map_submap)
        for track, poses in zip(kept.graph.tracks, _placed(kept), strict=True)
        for number, T_map_submap in zip(track.submaps, poses, strict=True)
        if number in by_number
    ]
    sessions = {one.number: one for one in uow.sessions.find(tenant, **equals)}
    present = {track.session_number: sessions[track.session_number] for track in kept.graph.tracks}
    if not placed:
        return None
    return MapSide(kept, present, tuple(one for one, _ in placed), np.stack([T for _, T in placed]))


def _only(task: MapTask, numbers: set[int]) -> MapTask:
    """The task with some of its submaps, and the loops between these."""
    tracks, ids = [], []
    for track, session_id in zip(task.graph.tracks, task.session_ids, strict=True):
        rows = [row for row, number in enumerate(track.submaps) if number in numbers]
        if rows:
            submaps = tuple(track.submaps[row] for row in rows)
            behind = np.searchsorted(rows, track.jumps, side="right") - 1
            jumps = tuple(int(one) for one in np.unique(behind) if 0 <= one < len(rows) - 1)
            tracks.append(replace(track, submaps=submaps, T_odom_submap=track.T_odom_submap[rows], jumps=jumps))
            ids.append(session_id)
    kept = [row for row, loop in enumerate(task.graph.loops) if {loop.match, loop.query} <= numbers]
    loops: tuple[LoopRecord, ...] = tuple(task.loops[row] for row in kept)
    fixed = tuple(one for one in task.graph.fixed if one.submap in numbers)
    graph = replace(task.graph, tracks=tuple(tracks), loops=tuple(task.graph.loops[row] for row in kept), fixed=fixed)
    return replace(task, graph=graph, session_ids=tuple(ids), loops=loops)


def _placed(task: MapTask) -> list[NDArray[np.float64]]:
    """T_map_submap (n, 4, 4) of each track in the oldest session's frame: by the version in force, else odometry.

    NaN for the sessions that have another frame, or none.
    """
    before = {row.session_number: row for row in task.before}
    first = task.graph.tracks[0].session_number if task.graph.tracks else 0
    frame = before[first].frame if first in before else frame_name(first)
    parts = []
    for track in task.graph.tracks:
        row, own = before.get(track.session_number), np.full((len(track.submaps), 4, 4), np.nan)
        if row is not None and row.frame == frame:
            known = PackedSubmaps.of(row.submaps)
            T_later = pose_matrix(row.T_map_odom) @ track.T_odom_submap
            places = [known.place_of(number) for number in track.submaps]
            own = np.stack([T if at is None else known.T_map_submap[at] for at, T in zip(places, T_later, strict=True)])
        elif row is None and track.session_number == first:
            own = track.T_odom_submap
        parts.append(own)
    return parts
