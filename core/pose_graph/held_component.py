"""A component as it was solved: its poses, its steps and the loops in the map as terms of least squares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.normal_equations import Edges

Array64 = NDArray[np.float64]


@dataclass(frozen=True)
class HeldComponent:
    """Trajectories of sessions that share a frame, and their poses `before` (n, 4, 4): those of the session that gives
    the frame first. edges: their steps, then the loops in the map; loops, all of theirs by place in the graph.
    """

    trajectories: tuple[Trajectory, ...]
    before: Array64
    edges: Edges
    loops: dict[int, LoopEdge]
    rows: dict[Node, int]

    @classmethod
    def of(
        cls,
        graph: PoseGraph,
        states: Sequence[GraphState],
        T_map_submap: Mapping[str, Array64],
        sessions: Sequence[str],
    ) -> HeldComponent:
        """That of `sessions`, the first of which gives the frame, by the `states` of the graph's loops."""
        trajectories = tuple(graph.by_session[one] for one in sessions)
        nodes = [Node(one.session, ordinal) for one in trajectories for ordinal in range(len(one))]
        rows = {node: row for row, node in enumerate(nodes)}
        loops = {n: one for n, one in enumerate(graph.loops) if one.match in rows and one.query in rows}
        kept = [one for n, one in loops.items() if states[n] is GraphState.IN_MAP]
        edges = Edges.of_steps(trajectories, rows).joined(Edges.of_loops(kept, rows))
        return cls(trajectories, np.concatenate([T_map_submap[one] for one in sessions]), edges, loops, rows)

    def squared_distances(self, poses: Array64) -> dict[int, float]:
        """The squared Mahalanobis distance of each loop from poses (n, 4, 4), by place in the graph."""
        squared = Edges.of_loops(list(self.loops.values()), self.rows).squared_errors(poses)
        return dict(zip(self.loops, squared.tolist(), strict=True))

    def squared_errors(self, poses: Array64) -> float:
        """Those of all steps and of the loops in the map, summed."""
        return float(self.edges.squared_errors(poses).sum())

    def by_session(self, values: Array64) -> dict[str, Array64]:
        """Values (n, ...) of all poses, by the session they belong to."""
        ends = np.cumsum([len(one) for one in self.trajectories])
        return {one.session: part for one, part in zip(self.trajectories, np.split(values, ends[:-1]), strict=True)}
