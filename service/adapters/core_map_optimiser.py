"""The pose graph of `core` behind the optimiser port. Its libraries are loaded by the first map that needs it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.pose_graph.graph import GraphState
from revisit.service.large_blocks import return_free_memory
from revisit.service.ports.map_optimiser import (
    FrameOnEarth,
    JudgedLoop,
    JudgedTrackAnchor,
    MapGraph,
    OptimisedMap,
    OptimisedTrack,
    Progress,
    SessionTrack,
    SolvedMap,
    SolvedTrack,
    TrackAnchor,
    TrackLoop,
)

if TYPE_CHECKING:
    from revisit.core.pose_graph.anchors import Anchor, Georeference, JudgedAnchor
    from revisit.core.pose_graph.graph import LoopEdge, Node, PoseGraph
    from revisit.core.pose_graph.optimisation import OptimisedGraph, SolvedByLoops
    from revisit.core.pose_graph.tags import TagSighting

Array64 = NDArray[np.float64]


class CoreMapOptimiser:
    """`MapOptimiser` by `core.pose_graph`."""

    def by_loops(self, graph: MapGraph, progress: Progress) -> CoreMapByLoops:
        """See `MapOptimiser`."""
        from revisit.core.pose_graph.optimisation import by_loops

        named = NamedGraph.of(graph)
        return CoreMapByLoops(named, by_loops(named.posed, progress=partial(progress, "OPTIMISE")))

    def solved(self, graph: MapGraph, tracks: Sequence[SolvedTrack]) -> SolvedMap:
        """See `MapOptimiser`."""
        from revisit.service.adapters.core_solved_map import CoreSolvedMap

        return_free_memory()  # its equations lie beside the free memory of earlier work, not in it
        named = NamedGraph.of(graph)
        return CoreSolvedMap(graph, named.posed, named.names, tracks)


@dataclass(frozen=True)
class CoreMapByLoops:
    """`MapByLoops` by `core.pose_graph`."""

    named: NamedGraph
    solved: SolvedByLoops

    def held(self, fixed: Sequence[TrackAnchor]) -> OptimisedMap:
        """See `MapByLoops`."""
        named = self.named.with_anchors(fixed)
        return named.answer(self.solved.held(named.fixed))


@dataclass(frozen=True)
class NamedGraph:
    """A map's graph as `core.pose_graph` takes it; `names` are those of its tracks.

    Names follow from odometry and measurements, not from numbers: the same sessions give the same poses, in any order
    and any map.
    """

    graph: MapGraph
    names: dict[int, str]
    posed: PoseGraph
    fixed: list[Anchor]
    sightings: list[TagSighting]
    _nodes: dict[int, Node]

    @classmethod
    def of(cls, graph: MapGraph) -> NamedGraph:
        """Steps are as uncertain as the odometry of their tracks."""
        from revisit.core.pose_graph.graph import Node, PoseGraph, Trajectory
        from revisit.core.pose_graph.independence import weighed

        names = _names(graph.tracks)
        trajectories = [
            replace(
                Trajectory.from_odometry(names[track.session_number], track.T_odom_submap, track.odometry),
                jumps=track.jumps,
            )
            for track in graph.tracks
        ]
        nodes = {
            number: Node(names[track.session_number], place)
            for track in graph.tracks
            for place, number in enumerate(track.submaps)
        }
        usable = [loop for loop in graph.loops if loop.number not in graph.refused]
        anchors = tuple(names[number] for number in graph.anchors or sorted(names))
        posed = PoseGraph.of(trajectories, _edges(usable, nodes), anchors)
        fixed, sightings = _anchors(graph.fixed, nodes), _sightings(graph.fixed, nodes)
        return cls(graph, names, weighed(posed, graph.window_m), fixed, sightings, nodes)

    def with_anchors(self, fixed: Sequence[TrackAnchor]) -> NamedGraph:
        """The graph with these anchors instead of its own."""
        return replace(self, fixed=_anchors(fixed, self._nodes), sightings=_sightings(fixed, self._nodes))

    def edges(self, loops: Sequence[TrackLoop]) -> list[LoopEdge]:
        """Further loops between its submaps."""
        return _edges(loops, self._nodes)

    def answer(self, optimised: OptimisedGraph, is_mended: bool = False) -> OptimisedMap:
        """The answer of the port; `is_mended` where it has undecided faults mended, too."""
        tracks = tuple(self._track(track, optimised, is_mended) for track in self.graph.tracks)
        judged = {
            loop_number(loop): JudgedLoop(loop_number(loop), state, float(distance))
            for loop, state, distance in zip(self.posed.loops, optimised.loops, optimised.residuals, strict=True)
        }
        judged |= {
            number: JudgedLoop(number, GraphState.SET_ASIDE, np.nan, reason)
            for number, reason in self.graph.refused.items()
        }
        loops = tuple(judged[loop.number] for loop in self.graph.loops)
        numbers = {name: number for number, name in self.names.items()}
        faults = tuple(replace(one, session=str(numbers[one.session])) for one in optimised.faults)
        return OptimisedMap(
            tracks,
            loops,
            optimised.chi2,
            optimised.degrees_of_freedom,
            faults,
            anchors=(*_judged(self.fixed, optimised.anchors), *_judged(self.sightings, self._by_tags(optimised))),
            on_earth=tuple(_on_earth(one, numbers) for one in optimised.georeferences),
            otherwise=None if optimised.otherwise is None else self.answer(optimised.otherwise, True),
            T_odom_submap={numbers[name]: its for name, its in optimised.T_odom_submap.items()},
        )

    def _by_tags(self, optimised: OptimisedGraph) -> Sequence[JudgedAnchor]:
        """The verdicts on the sightings of tags."""
        from revisit.core.pose_graph.tags import judged_sightings

        drives = {name: self.posed.by_session[name].T_odom_submap for name in self.names.values()}
        return judged_sightings(drives, optimised.T_map_submap, optimised.components, self.sightings)

    def _track(self, track: SessionTrack, optimised: OptimisedGraph, is_mended: bool) -> OptimisedTrack:
        from revisit.core.pose_graph.faults import torn

        name = self.names[track.session_number]
        its = [one for one in optimised.faults if one.session == name and (is_mended or not one.undecided)]
        drive, mended = self.posed.by_session[name], optimised.T_odom_submap[name]
        group = next(group for group in optimised.components if name in group)
        return OptimisedTrack(
            session_number=track.session_number,
            anchor=next(number for number, known in self.names.items() if known == group[0]),
            T_map_odom=optimised.T_map_odom(drive),
            T_map_submap=optimised.T_map_submap[name],
            covariances=optimised.covariances[name] + torn(drive, mended, its, self.graph.window_m),
        )


def loop_number(loop: LoopEdge) -> int:
    """The number of a loop by its name in a `NamedGraph`."""
    return _number(loop.name)


def _number(name: str) -> int:
    """The number at the end of a name of a loop or an anchor."""
    return int(name.rpartition(":")[2])


def _judged(anchors: Sequence[Anchor | TagSighting], verdicts: Iterable[JudgedAnchor]) -> Iterator[JudgedTrackAnchor]:
    for one, verdict in zip(anchors, verdicts, strict=True):
        yield JudgedTrackAnchor(_number(one.name), verdict)


def _names(tracks: tuple[SessionTrack, ...]) -> dict[int, str]:
    """Names of tracks, in alphabetical order by their odometry; of equal ones by their numbers."""
    ordered = sorted(tracks, key=lambda track: (_digest(track.T_odom_submap), track.session_number))
    return {track.session_number: f"{rank:09d}" for rank, track in enumerate(ordered)}


def _digest(array: Array64) -> str:
    return hashlib.sha256(np.ascontiguousarray(array, dtype="<f8").tobytes()).hexdigest()


def _anchors(fixed: Sequence[TrackAnchor], nodes: dict[int, Node]) -> list[Anchor]:
    """Anchors in an order of their own, as loops have one."""
    from revisit.core.pose_graph.anchors import Anchor

    made = [
        Anchor(
            f"{_digest(np.concatenate([one.place_enu, one.point_submap, one.covariance.ravel()]))}:{one.number}",
            nodes[one.submap],
            one.point_submap,
            one.place_enu,
            one.covariance,
            one.heading,
        )
        for one in fixed
        if one.tag is None
    ]
    return sorted(made, key=lambda one: (one.node, one.name))


def _sightings(fixed: Sequence[TrackAnchor], nodes: dict[int, Node]) -> list[TagSighting]:
    """Sightings of tags, in an order of their own, too."""
    from revisit.core.pose_graph.tags import TagSighting

    made = [
        TagSighting(
            f"{_digest(one.point_submap)}:{one.number}", nodes[one.submap], one.tag, one.point_submap, one.sigma_m
        )
        for one in fixed
        if one.tag is not None
    ]
    return sorted(made, key=lambda one: (one.node, one.tag, one.name))


def _on_earth(found: Georeference, numbers: Mapping[str, int]) -> FrameOnEarth:
    """A frame on earth, sessions by their numbers."""
    told = (replace(one, session=str(numbers[one.session])) for one in found.sessions)
    return FrameOnEarth(numbers[found.session], replace(found, sessions=tuple(told)))


def _edges(loops: Sequence[TrackLoop], nodes: dict[int, Node]) -> list[LoopEdge]:
    from revisit.core.pose_graph.graph import LoopEdge, loop_covariances

    covariances = loop_covariances([loop.covariance for loop in loops])
    return [
        LoopEdge(
            f"{_digest(loop.T_match_query)}:{loop.number}", nodes[loop.match], nodes[loop.query], loop.T_match_query,
            covariance,
        )
        for loop, covariance in zip(loops, covariances, strict=True)
    ]  # fmt: skip
