"""One loop more: the poses of a solved graph, moved by Gauss-Newton steps from where they are."""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from revisit.core.pose_graph.graph import LoopEdge, PoseGraph
from revisit.core.pose_graph.least_squares import minimise
from revisit.core.pose_graph.optimisation import GATE, LoopState, OptimisedGraph, Problem, poses_of

Array64 = NDArray[np.float64]

SETTLED_M = 0.1
"""A step that moves no submap farther is the last one, metres: what is left is of second order, millimetres."""

MAX_STEPS = 5


class SolvedComponent:
    """Sessions that share a frame, as `optimise` left them, ready for further loops between them.

    `commit` finds loops again that were set aside, and wrong ones that slipped in; this does neither.
    """

    def __init__(self, graph: PoseGraph, optimised: OptimisedGraph, sessions: tuple[str, ...]) -> None:
        """The component of `optimised` that holds `sessions`, with the loops in the map."""
        self._problem = Problem.solved(graph, sessions, optimised.T_map_submap)
        kept = [n for n in self._problem.loops if optimised.loops[n] is LoopState.IN_MAP]
        self._factors, self._values = self._problem.graph(kept), self._problem.start
        self._ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(self._factors)

    def add(self, loop: LoopEdge) -> LoopState:
        """Take the loop into the map, or set it aside where the poses, as sure as they are, contradict it.

        By how much the least cost grows is the squared Mahalanobis distance of the loop from the poses, with their
        covariance: that is held against the gate.
        """
        factors = gtsam.NonlinearFactorGraph(self._factors)
        factors.add(self._problem.factor(loop))
        values = self._settled(factors)
        if 2.0 * (factors.error(values) - self._factors.error(self._values)) > GATE:
            return LoopState.SET_ASIDE
        self._factors, self._values = factors, values
        return LoopState.IN_MAP

    def T_map_submap(self) -> dict[str, Array64]:
        """The poses (n, 4, 4) of each session."""
        return poses_of(self._problem.trajectories, self._values)

    def _settled(self, factors: gtsam.NonlinearFactorGraph) -> gtsam.Values:
        values = self._values
        for _ in range(MAX_STEPS):
            before = values
            try:
                values = values.retract(factors.linearize(values).optimize(self._ordering))
            except RuntimeError:  # too long a chain for Gauss-Newton: damping helps
                return minimise(factors, values)
            if np.abs(_positions(values) - _positions(before)).max() < SETTLED_M:
                break
        return values


def _positions(values: gtsam.Values) -> Array64:
    return np.asarray(gtsam.utilities.extractPose3(values)[:, 9:])
