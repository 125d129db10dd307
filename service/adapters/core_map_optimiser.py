"""The pose graph of `core` behind the optimiser port. What it stands on is loaded by the first map that needs it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.service.application.contract.map_optimiser import (
    JudgedLoop,
    MapGraph,
    OptimisedMap,
    OptimisedTrack,
    SessionTrack,
    TrackLoop,
)
from revisit.service.application.contract.states import GraphState

if TYPE_CHECKING:
    from revisit.core.pose_graph import LoopEdge, Node, OptimisedGraph, PoseGraph

Array64 = NDArray[np.float64]


class CoreMapOptimiser:
    """`MapOptimiser` by `core.pose_graph`."""

    def optimise(self, graph: MapGraph) -> OptimisedMap:
        """See `MapOptimiser`. The oldest of the sessions that are joined gives the frame."""
        from revisit.core.pose_graph import optimise

        posed = pose_graph(graph)
        optimised = optimise(posed)
        tracks = tuple(_optimised_track(track, posed, optimised) for track in graph.tracks)
        judged = {
            int(loop.name): JudgedLoop(int(loop.name), GraphState(state.value), float(distance))
            for loop, state, distance in zip(posed.loops, optimised.loops, optimised.residuals, strict=True)
        }
        loops = tuple(judged[loop.number] for loop in graph.loops)
        return OptimisedMap(tracks, loops, optimised.chi2, optimised.degrees_of_freedom)


def pose_graph(graph: MapGraph) -> PoseGraph:
    """The graph that `core.pose_graph` optimises; steps are as uncertain as its model of odometry says."""
    from revisit.core.pose_graph import Node, PoseGraph, Trajectory
    from revisit.core.pose_graph.independence import weighed

    trajectories = [
        Trajectory.from_odometry(_name(track.session_number), track.T_odom_submap) for track in graph.tracks
    ]
    nodes = {
        number: Node(_name(track.session_number), place)
        for track in graph.tracks
        for place, number in enumerate(track.submaps)
    }
    return weighed(PoseGraph.of(trajectories, [_edge(loop, nodes) for loop in graph.loops]), graph.window_m)


def _optimised_track(track: SessionTrack, posed: PoseGraph, optimised: OptimisedGraph) -> OptimisedTrack:
    name = _name(track.session_number)
    group = next(group for group in optimised.components if name in group)
    return OptimisedTrack(
        session_number=track.session_number,
        anchor=int(min(group)),
        T_map_odom=optimised.T_map_odom(posed.by_session[name]),
        T_map_submap=optimised.T_map_submap[name],
        covariances=optimised.covariances[name],
    )


def _edge(loop: TrackLoop, nodes: dict[int, Node]) -> LoopEdge:
    from revisit.core.pose_graph import LoopEdge, loop_covariance

    covariance = loop_covariance(loop.covariance)
    return LoopEdge(_name(loop.number), nodes[loop.match], nodes[loop.query], loop.T_match_query, covariance)


def _name(number: int) -> str:
    """A name whose alphabetical order is that of the numbers."""
    return f"{number:019d}"
