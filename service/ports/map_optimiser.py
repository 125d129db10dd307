"""The optimisation of a map's pose graph, as the workers call it.

Tracks and loops are named by the numbers of their rows, and stay beside the types of `core.pose_graph`: there, sessions
and loops are named by their content, so that the same drives give the same poses, whatever their numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4
from revisit.core.merge.evidence import MergeEvidence, MergeRefusal
from revisit.core.pose_graph.anchors import Georeference, Heading, JudgedAnchor
from revisit.core.pose_graph.faults import OdometryFault
from revisit.core.pose_graph.graph import GraphState, OdometryModel

Array64 = NDArray[np.float64]

Progress = Callable[[str, int, int], None]
"""Called with a stage, and how much of how much of it is done. May raise, which ends the work."""


@dataclass(frozen=True)
class SessionTrack:
    """The submaps of a session in the order of their drive, by number, where its odometry saw them (n, 4, 4), how fast
    that drifts, and the places in that order behind which it jumps.
    """

    session_number: int
    submaps: tuple[int, ...]
    T_odom_submap: Array64
    odometry: OdometryModel = OdometryModel()
    jumps: tuple[int, ...] = ()


@dataclass(frozen=True)
class TrackLoop:
    """A loop of number `number` between two submaps, by number.

    T_match_query (4, 4); covariance (6, 6) of its tangent (x, y, z, rx, ry, rz) in the match frame, metres and radians,
    None where nobody measured it.
    """

    number: int
    match: int
    query: int
    T_match_query: Matrix4
    covariance: Array64 | None


@dataclass(frozen=True)
class TrackAnchor:
    """An anchor of number `number`: point_submap (3,) of submap `submap`, by number, lies at place_enu (3,), metres
    east, north and up from the origin of the map, with covariance (3, 3); or, of a `tag`, at a place that nobody knows.
    """

    number: int
    submap: int
    point_submap: Array64
    place_enu: Array64
    covariance: Array64
    heading: Heading | None = None
    tag: str | None = None

    @property
    def sigma_m(self) -> float:
        """The largest standard deviation of its place in any direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]))


@dataclass(frozen=True)
class MapGraph:
    """The sessions of a map and the accepted loops between their submaps, each of which covers `window_m` metres.

    Of sessions that loops join, the first that `anchors` numbers gives the frame; the oldest where it is empty.
    `refused` loops, by number, each with the reason, count for nothing and are SET_ASIDE. `fixed`: anchors on earth.
    """

    tracks: tuple[SessionTrack, ...]
    loops: tuple[TrackLoop, ...]
    window_m: float
    anchors: tuple[int, ...] = ()
    refused: Mapping[int, str] = field(default_factory=dict)
    fixed: tuple[TrackAnchor, ...] = ()


@dataclass(frozen=True)
class JudgedTrackAnchor:
    """The graph's verdict on the anchor of a number."""

    number: int
    verdict: JudgedAnchor


@dataclass(frozen=True)
class FrameOnEarth:
    """The place on earth of the frame that the session of a number gives; sessions of `found` are such numbers, too."""

    session_number: int
    found: Georeference

    def renumbered(self, number_of: Callable[[int], int]) -> FrameOnEarth:
        """The same with other numbers of the sessions."""
        told = (replace(one, session=str(number_of(int(one.session)))) for one in self.found.sessions)
        return FrameOnEarth(number_of(self.session_number), replace(self.found, sessions=tuple(told)))


@dataclass(frozen=True)
class OptimisedTrack:
    """A session in a frame of the map, which is the odometry frame of the session of number `anchor`.

    T_map_submap (n, 4, 4) and covariances (n, 6, 6), each of the tangent (x, y, z, rx, ry, rz) in the submap's frame,
    are of the submaps of its track; T_map_odom (4, 4) is its correction as of the last of them.
    """

    session_number: int
    anchor: int
    T_map_odom: Matrix4
    T_map_submap: Array64
    covariances: Array64


@dataclass(frozen=True)
class JudgedLoop:
    """The graph's verdict on a loop; its squared Mahalanobis distance from the poses, NaN where its sessions share no
    frame; the reason of a refused one.
    """

    number: int
    state: GraphState
    squared_distance: float
    refusal: str | None = None


FAULTS = "odometry_faults"
"""Where the stored summary of a version keeps the faults of odometry, beside the fields of a MapVersionSummary."""

GEOREFERENCES, SESSIONS = "georeferences", "sessions"
"""Where the stored summary of a version keeps the frames that lie on earth, where there are any, and such a frame the
sessions whose anchors are not as they state.
"""

AUDITED = "audited_submaps"
"""Where the stored summary of a version keeps `OptimisedMap.audited`."""

REFUSED_JOINS = "refused_joins"
"""Where the stored summary of a version keeps them, where there are any."""


@dataclass(frozen=True)
class RefusedJoin:
    """Sessions, by number on both sides, that so many loops would join and whose surfaces speak against it."""

    sessions: tuple[int, ...]
    others: tuple[int, ...]
    reason: MergeRefusal
    loops: int
    evidence: MergeEvidence


@dataclass(frozen=True)
class OptimisedMap:
    """The most likely poses, what they say of every loop, how well they fit (`chi2` by `degrees_of_freedom`), the
    faults of odometry without which they do (`session` is the number), and the joins that surfaces speak against.

    audited: how many submaps each session, by number, had when its surfaces were last compared with others. anchors:
    the verdicts on them; on_earth, the frames that they hold. otherwise: the solution with undecided faults mended.
    T_odom_submap (n, 4, 4): the odometry of each session, by number, as the poses have it, with faults mended.
    """

    tracks: tuple[OptimisedTrack, ...]
    loops: tuple[JudgedLoop, ...]
    chi2: float
    degrees_of_freedom: int
    faults: tuple[OdometryFault, ...] = ()
    refused_joins: tuple[RefusedJoin, ...] = ()
    audited: Mapping[int, int] = field(default_factory=dict)
    anchors: tuple[JudgedTrackAnchor, ...] = ()
    on_earth: tuple[FrameOnEarth, ...] = ()
    otherwise: OptimisedMap | None = None
    T_odom_submap: Mapping[int, NDArray[np.float64]] = field(default_factory=dict)


@dataclass(frozen=True)
class SolvedTrack:
    """The poses (n, 4, 4) of a session's submaps by an earlier optimisation, in the frame of session `anchor`."""

    session_number: int
    anchor: int
    T_map_submap: Array64


class SolvedMap(Protocol):
    """An optimised map with its factorisation, updated incrementally with single submaps and loops."""

    def append(self, session_number: int, submap: int, T_odom_submap: Matrix4) -> None:
        """A further submap, by number, of a session; one of a session that the map does not have changes nothing."""
        ...

    def add(self, loop: TrackLoop) -> bool:
        """Add a loop; whether it moves the map. It does not if it contradicts the map or joins sessions without a
        common frame.
        """
        ...

    def corrections(self) -> dict[int, Matrix4]:
        """T_map_odom (4, 4) by number of the sessions in frames that loops have changed, as of their last submaps."""
        ...

    def refresh(self) -> None:
        """Prepare for further loops, when there is time."""
        ...


class MapByLoops(Protocol):
    """A map solved by its drives and loops, before any anchor is asked."""

    def held(self, fixed: Sequence[TrackAnchor]) -> OptimisedMap:
        """The map by these anchors, too: bit for bit as if its graph had no others."""
        ...


class MapOptimiser(Protocol):
    """Places the sessions of a map to each other."""

    def by_loops(self, graph: MapGraph, progress: Progress) -> MapByLoops:
        """The map without the anchors of the graph. The same graph gives the same answer, bit for bit. Tracks and loops
        answer in their order.
        """
        ...

    def solved(self, graph: MapGraph, tracks: Sequence[SolvedTrack]) -> SolvedMap:
        """The map with poses of the tracks of the graph in their order; they rest on all of its loops."""
        ...
