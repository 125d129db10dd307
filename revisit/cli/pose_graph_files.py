"""The submaps and loops of a map as a pose graph, and in files that other tools read: g2o, TUM and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.sdk.client import Client
from revisit.sdk.resources import LoopClosure, Submap

if TYPE_CHECKING:
    from revisit.core.pose_graph.graph import LoopEdge, Node, PoseGraph
    from revisit.core.pose_graph.optimisation import OptimisedGraph


@dataclass(frozen=True)
class Graph:
    """Submaps by session in their order, the accepted loops between them, and the stated drift of each session."""

    tracks: list[list[Submap]]
    loops: list[LoopClosure]
    drifts: dict[str, str | None] = field(default_factory=dict)


def read_graph(http: str, map_id: str, session_id: str = "") -> Graph:
    """The submaps and accepted loops of a map, or of one session of it."""
    map_name = f"maps/{map_id}"
    with Client(http) as client:
        if session_id:
            sessions = [client.get_session(f"{map_name}/sessions/{session_id}")]
        else:
            sessions = client.list_sessions(map_name)
        tracks = [client.list_submaps(session) for session in sessions]
        loops = client.loop_closures(map_name, state="ACCEPTED")
    chosen = {submap.name for track in tracks for submap in track}
    drifts = {session.name: session.drift for session in sessions}
    return Graph(tracks, [loop for loop in loops if {loop.query, loop.match} <= chosen], drifts)


def pose_graph(graph: Graph) -> PoseGraph:
    """The graph that `core.pose_graph` optimises; steps are as uncertain as their session states."""
    from revisit.core.pose_graph.graph import Node, OdometryModel, PoseGraph, Trajectory

    tracks = [track for track in graph.tracks if track]
    node = {submap.name: Node(_session(submap), n) for track in tracks for n, submap in enumerate(track)}
    trajectories = [
        Trajectory.from_odometry(
            name := _session(track[0]),
            np.stack([submap.T_odom_submap for submap in track]),
            OdometryModel.stated(graph.drifts.get(name)),
        )
        for track in tracks
    ]
    edges = [_edge(loop, loop.T_match_query, node) for loop in graph.loops if loop.T_match_query is not None]
    return PoseGraph.of(trajectories, edges)


def as_g2o(graph: Graph) -> str:
    """The optimised graph with its odometry and the loops it rests on.

    Sessions that loops join lie in one frame; the first vertex of each group of sessions is fixed.
    """
    from revisit.core.pose_graph.optimisation import optimise

    posed = pose_graph(graph)
    return optimised_g2o(posed, optimise(posed)) if posed.trajectories else ""


def optimised_g2o(graph: PoseGraph, optimised: OptimisedGraph) -> str:
    """`as_g2o` of a graph that was optimised."""
    from revisit.core.pose_graph.g2o import write_g2o
    from revisit.core.pose_graph.graph import GraphState

    states = zip(graph.loops, optimised.loops, strict=True)
    kept = tuple(loop for loop, state in states if state is GraphState.IN_MAP)
    text = write_g2o(replace(graph, loops=kept), optimised.T_map_submap)
    first, fixed = 0, []
    for one in graph.trajectories:
        if one.session in {group[0] for group in optimised.components}:
            fixed.append(f"FIX {first}")
        first += len(one)
    return text.replace("FIX 0\n", "\n".join(fixed) + "\n", 1)


def as_tum(graph: Graph) -> str:
    """`stamp x y z qx qy qz qw`, stamp in seconds, of the submaps in their odometry frame."""
    return tum_lines((submap, submap.T_odom_submap) for track in graph.tracks for submap in track)


def tum_lines(poses: Iterable[tuple[Submap, Matrix4]]) -> str:
    """`stamp x y z qx qy qz qw` of each submap and its pose (4, 4)."""
    return "\n".join(tum_line(one.stamp_ns, pose) for one, pose in poses) + "\n"


def tum_line(stamp_ns: int, pose: Matrix4) -> str:
    """`stamp x y z qx qy qz qw`, stamp in seconds."""
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} {_numbers(pose)}"


def as_csv(graph: Graph) -> str:
    """One row a loop: query, match, similarity, score and T_match_query."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["query", "match", "similarity", "score", "x", "y", "z", "qx", "qy", "qz", "qw"])
    for loop in graph.loops:
        pose = [] if loop.T_match_query is None else _numbers(loop.T_match_query).split()
        writer.writerow([loop.query, loop.match, loop.similarity, loop.score, *pose])
    return buffer.getvalue()


def _session(submap: Submap) -> str:
    return submap.name.partition("/submaps/")[0]


def _edge(loop: LoopClosure, T_match_query: Matrix4, node: dict[str, Node]) -> LoopEdge:
    from revisit.core.pose_graph.graph import LoopEdge

    return LoopEdge(loop.name, node[loop.match], node[loop.query], T_match_query, _covariance(loop))


def _covariance(loop: LoopClosure) -> NDArray[np.float64]:
    """The covariance (x, y, z, rx, ry, rz) in the match frame, as verification measured it."""
    from revisit.core.pose_graph.graph import loop_covariance

    measured = np.asarray(loop.evidence.get("measurement", {}).get("covariance", []), dtype=np.float64)
    usable = measured.size == 36 and bool(np.isfinite(measured).all())
    return loop_covariance(measured.reshape(6, 6) if usable else None)


def _numbers(transform: Matrix4) -> str:
    values = [*transform[:3, 3], *se3.to_quaternion(transform)]
    return " ".join(f"{value:.9f}" for value in values)
