"""Anchors of a map, as its pose graph has them."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import geodesy, se3
from revisit.core.geometry.se3 import Matrix4, pose_matrix, pose_row
from revisit.core.merge.evidence import MergeRefusal
from revisit.core.pose_graph.anchors import Anchor, AnchoredSession, Heading
from revisit.core.pose_graph.anchors_against_loops import refuted_by_anchors
from revisit.core.pose_graph.anchors_for_loops import AnchorsForLoops, OpenPair
from revisit.core.pose_graph.graph import LoopEdge, Node
from revisit.core.pose_graph.tags import TagSighting
from revisit.core.pose_graph.tags_between import refuted_by_tags
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import AnchorRecord, MapRecord
from revisit.service.domain.states import AnchorFrame
from revisit.service.features.graph.map_frames import frame_name
from revisit.service.ports.map_optimiser import GEOREFERENCES, SESSIONS, FrameOnEarth, MapGraph, TrackAnchor
from revisit.service.ports.repositories import PlacedSubmap
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork

Array64 = NDArray[np.float64]

ONE_SITE_M = 100_000.0
"""Anchors of one site are not farther from most of them."""

FIRST_ANCHORS = 200
"""So many are looked at for an origin: as many as a request has."""


def read_anchors(
    uow: UnitOfWork, record: MapRecord, placed: Iterable[PlacedSubmap], more: Sequence[AnchorRecord] = ()
) -> tuple[TrackAnchor, ...]:
    """The anchors of a map, and `more`, whose sessions have submaps: each on the submap nearest in time."""
    rows = [*uow.anchors.find(record.tenant, map_id=record.map_id), *more]
    if not rows:
        return ()
    numbers = {one.session_id: one.number for one in uow.sessions.find(record.tenant, map_id=record.map_id)}
    of_sessions: dict[int, list[PlacedSubmap]] = {}
    for one in placed:
        of_sessions.setdefault(one.session_number, []).append(one)
    drives = {number: SubmapsInTime.of(drive) for number, drive in of_sessions.items()}
    places = world_places(rows, origin_by(record, rows))
    return tuple(
        track_anchor(row, place, drives[numbers[row.session_id]].nearest(row.stamp_ns))
        for row, place in zip(rows, places, strict=True)
        if numbers.get(row.session_id) in drives
    )


@dataclass(frozen=True)
class SubmapsInTime:
    """The submaps of a session in the order of their times."""

    submaps: Sequence[PlacedSubmap]
    stamps_ns: Sequence[int]

    @classmethod
    def of(cls, submaps: Iterable[PlacedSubmap]) -> SubmapsInTime:
        """Submaps in the order of the drive, which stays that of those of one time."""
        ordered = sorted(submaps, key=lambda one: one.stamp_ns)
        return cls(ordered, [one.stamp_ns for one in ordered])

    def nearest(self, stamp_ns: int) -> PlacedSubmap:
        """The submap nearest in time; of several the first of the drive."""
        after = bisect_left(self.stamps_ns, stamp_ns)
        near = {max(0, after - 1), min(after, len(self.stamps_ns) - 1)}
        firsts = [self.submaps[bisect_left(self.stamps_ns, self.stamps_ns[one])] for one in near]
        return min(firsts, key=lambda one: (abs(one.stamp_ns - stamp_ns), one.ordinal))


def origin_by(record: MapRecord, rows: Iterable[AnchorRecord]) -> tuple[float, float, float] | None:
    """The origin of a map: its own, else the first place on earth of these anchors of it; None without any.

    The first that lies where most do: receivers tell (0, 0) before they have a fix.
    """
    if record.origin is not None:
        return record.origin
    on_earth = [row.position for row in rows if row.frame == AnchorFrame.WGS84]
    if not on_earth:
        return None
    places = geodesy.ecef(on_earth)
    near = np.linalg.norm(places - np.median(places, axis=0), axis=1) < ONE_SITE_M
    return on_earth[int(np.argmax(near)) if 2 * near.sum() > len(near) else 0]


def is_another_site(origin: tuple[float, float, float] | None, rows: Iterable[AnchorRecord]) -> bool:
    """Whether anchors on earth lie so far from an origin that one of both is false."""
    on_earth = [row.position for row in rows if row.frame == AnchorFrame.WGS84]
    if origin is None or not on_earth:
        return False
    return bool(np.linalg.norm(geodesy.ecef(on_earth) - geodesy.ecef([origin]), axis=1).max() > ONE_SITE_M)


def move_origin(uow: UnitOfWork, tenant: TenantId, map_id: str) -> None:
    """Where the anchor that gave a map its origin is gone, or no place of the site, the first place on earth left
    becomes it, or none.

    It stays where a version lies on earth by it, or an anchor is measured from it.
    """
    record = require_map(uow, tenant, map_id, hold=True)
    first, local = (
        uow.anchors.find(tenant, limit=limit, map_id=map_id, frame=frame.value)
        for frame, limit in ((AnchorFrame.WGS84, FIRST_ANCHORS), (AnchorFrame.LOCAL, 1))
    )
    origin = origin_by(replace(record, origin=None), first)
    if record.origin in (None, origin) or local:
        return
    if any(GEOREFERENCES in one.summary for one in uow.map_versions.find(tenant, map_id=map_id)):
        return
    uow.maps.replace(replace(record, origin=origin))


def world_places(rows: Sequence[AnchorRecord], origin: tuple[float, float, float] | None) -> Array64:
    """The places (n, 3) of anchors in metres east, north and up from the origin of their map."""
    places = np.reshape([row.position for row in rows], (-1, 3)).astype(np.float64)
    on_earth = np.array([row.frame == AnchorFrame.WGS84 for row in rows], dtype=bool)
    if origin is not None and on_earth.any():
        places[on_earth] = geodesy.enu(origin, places[on_earth])
    return places


def track_anchor(row: AnchorRecord, place: Array64, submap: PlacedSubmap) -> TrackAnchor:
    """An anchor as a pose graph has it, on a submap of its session."""
    T_submap_sensor = se3.inverse(pose_matrix(submap.T_odom_submap)) @ pose_matrix(row.T_odom_sensor)
    heading = None
    if row.heading_rad is not None and row.heading_sigma_rad is not None:
        heading = Heading(T_submap_sensor[:3, 0], row.heading_rad, row.heading_sigma_rad)
    point = se3.apply(T_submap_sensor, np.array([row.offset_m]))[0]
    covariance = np.reshape(row.covariance, (3, 3))
    return TrackAnchor(row.number, submap.number, point, place, covariance, heading, row.tag)


def loops_against(graph: MapGraph, fixed: Sequence[TrackAnchor]) -> dict[int, str]:
    """The loops of a graph that anchors speak against, by number, each with the reason."""
    if not fixed:
        return {}
    nodes = _nodes(graph)
    unread = np.eye(6)  # the covariance of a loop says nothing here
    loops = [
        LoopEdge(str(one.number), nodes[one.match], nodes[one.query], one.T_match_query, unread) for one in graph.loops
    ]
    refuted = refuted_by_anchors(_drives(graph), loops, _anchors(nodes, fixed))
    refuted |= refuted_by_tags(_drives(graph), loops, _sightings(nodes, fixed))
    return dict.fromkeys(sorted(map(int, refuted)), MergeRefusal.ANCHORS_DISAGREE.value)


@dataclass(frozen=True)
class AnchoredSubmaps:
    """The submaps of a map, by number, and where their anchors put them."""

    nodes: Mapping[int, Node]
    asked: AnchorsForLoops

    @classmethod
    def of(cls, graph: MapGraph, fixed: Sequence[TrackAnchor]) -> AnchoredSubmaps:
        """Those of a graph, by these anchors."""
        nodes = _nodes(graph)
        return cls(nodes, AnchorsForLoops(_drives(graph), _anchors(nodes, fixed), _sightings(nodes, fixed)))

    def pair(self, number: int, match: int, query: int, poses: tuple[Matrix4, ...]) -> OpenPair:
        """The pair of ambiguous loop `number` between two submaps, and the poses T_match_query (4, 4) that fit it."""
        return OpenPair(str(number), self.nodes[match], self.nodes[query], poses)

    def accepted(self, number: int, match: int, query: int, poses: tuple[Matrix4, ...], by_anchors: bool) -> OpenPair:
        """As `pair`, of an accepted loop, which has the first pose; anchors chose it, or did not."""
        if by_anchors:
            return replace(self.pair(number, match, query, poses), chosen=True)
        return replace(self.pair(number, match, query, poses[:1]), accepted=True)

    def is_within(self, match: int, query: int, reach_m: float) -> bool:
        """Whether anchors put two submaps so near to each other."""
        if match not in self.nodes or query not in self.nodes:
            return False
        apart_m = self.asked.apart_m(self.nodes[match], self.nodes[query])
        return apart_m is not None and apart_m <= reach_m


def _nodes(graph: MapGraph) -> dict[int, Node]:
    return {
        number: Node(str(track.session_number), place)
        for track in graph.tracks
        for place, number in enumerate(track.submaps)
    }


def _drives(graph: MapGraph) -> dict[str, Array64]:
    return {str(track.session_number): track.T_odom_submap for track in graph.tracks}


def _anchors(nodes: Mapping[int, Node], fixed: Iterable[TrackAnchor]) -> list[Anchor]:
    return [
        Anchor(str(one.number), nodes[one.submap], one.point_submap, one.place_enu, one.covariance)
        for one in fixed
        if one.tag is None
    ]


def _sightings(nodes: Mapping[int, Node], fixed: Iterable[TrackAnchor]) -> list[TagSighting]:
    return [
        TagSighting(str(one.number), nodes[one.submap], one.tag, one.point_submap, one.sigma_m)
        for one in fixed
        if one.tag is not None
    ]


def stored_frames(frames: Iterable[FrameOnEarth], names: Mapping[int, str]) -> list[dict[str, Any]]:
    """Frames on earth in the form of a version's summary; names, those of sessions by number."""
    return [
        {
            "frame": frame_name(one.session_number),
            "T_enu_map": list(pose_row(one.found.T_world_map)),
            "covariance": one.found.covariance.ravel().tolist() if np.isfinite(one.found.covariance).all() else [],
            "anchors": one.found.anchors,
            "of_anchors": one.found.of_anchors,
            "residual_m": one.found.residual_m,
            **({SESSIONS: told} if (told := _told(one.found.sessions, names)) else {}),
        }
        for one in frames
    ]


def _told(sessions: Iterable[AnchoredSession], names: Mapping[int, str]) -> list[dict[str, Any]]:
    return [
        {
            "session": names[int(one.session)],
            "anchors": one.anchors,
            "of_anchors": one.of_anchors,
            "offset_m": one.offset_m.tolist(),
            "sigma_factor": one.sigma_factor,
            "elsewhere": one.elsewhere,
        }
        for one in sessions
        if int(one.session) in names
    ]
