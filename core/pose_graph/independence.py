"""How much of a loop its neighbours do not say already: windows that overlap show the same surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from revisit.core.pose_graph.graph import LoopEdge, Node, PoseGraph

Array64 = NDArray[np.float64]

_PAIRS_AT_ONCE = 1 << 18


def weighed(graph: PoseGraph, window_m: float) -> PoseGraph:
    """The graph with the `independent_share` of each of its loops, whose submaps cover `window_m` metres each.

    Two loops between the same sessions share the overlap of their windows at both ends; a loop that shares as much with
    others as a whole one is worth a half. A far loop shares nothing.
    """
    groups: dict[tuple[str, str], list[int]] = {}
    for number, loop in enumerate(graph.loops):
        groups.setdefault((loop.match.session, loop.query.session), []).append(number)
    loops = list(graph.loops)
    for members in groups.values():
        for number, share in zip(members, _shares(graph, [loops[n] for n in members], window_m), strict=True):
            loops[number] = replace(loops[number], independent_share=float(share))
    return replace(graph, loops=tuple(loops))


def share_beside(ends_m: Array64, others_m: Array64, window_m: float) -> float:
    """The `independent_share` of one more loop whose ends (2, 3) are here, beside others (l, 2, 3) of its sessions.

    Positions of match and query in the odometry of their sessions, metres.
    """
    near = np.maximum(0.0, 1.0 - np.linalg.norm(others_m - ends_m, axis=2) / window_m)
    return float(1.0 / (1.0 + near.prod(axis=1).sum()))


def _shares(graph: PoseGraph, loops: list[LoopEdge], window_m: float) -> Array64:
    """The share (l,) of each of some loops between the same two sessions."""
    matches = np.stack([_position(graph, loop.match) for loop in loops])
    queries = np.stack([_position(graph, loop.query) for loop in loops])
    at_once = max(1, _PAIRS_AT_ONCE // len(loops))
    starts = range(0, len(loops), at_once)
    return np.concatenate([_of_rows(slice(start, start + at_once), matches, queries, window_m) for start in starts])


def _of_rows(rows: slice, matches: Array64, queries: Array64, window_m: float) -> Array64:
    """The shares of some of the loops: one over the number of loops that say the same."""
    common = _overlap(matches[rows], matches, window_m) * _overlap(queries[rows], queries, window_m)
    return np.asarray(1.0 / common.sum(axis=1))


def _overlap(positions: Array64, others: Array64, window_m: float) -> Array64:
    """The overlap of windows at positions (n, 3) with those at others (m, 3): 0 to 1, (n, m)."""
    return np.asarray(np.maximum(0.0, 1.0 - cdist(positions, others) / window_m))


def _position(graph: PoseGraph, node: Node) -> Array64:
    return graph.by_session[node.session].T_odom_submap[node.ordinal, :3, 3]
