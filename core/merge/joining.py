"""Evidence of the loops between two groups of sessions for joining them, beyond poses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.path import travelled_m
from revisit.core.merge.evidence import JoiningLoops
from revisit.core.pose_graph.consistency import agreement, largest_clique, oriented
from revisit.core.pose_graph.graph import GraphState, LoopEdge, PoseGraph
from revisit.core.pose_graph.optimisation import OptimisedGraph

LONGEST_GAP_M = 50.0
"""Metres of a drive without a loop, beyond which it does not count as common track."""

RIVAL_APART_M = 2.0
RIVAL_APART_RAD = np.radians(10.0)
"""How far from the poses loops put their submaps that speak for another alignment: nearer ones only measured badly."""


def joining_loops(
    graph: PoseGraph,
    optimised: OptimisedGraph,
    second: frozenset[str],
    scale: float = 1.0,
    spare: Sequence[LoopEdge] = (),
) -> JoiningLoops:
    """Those with one end in the sessions `second` and one in others; `scale` is that of the scene.

    `spare` loops the poses do not rest on; they may speak for another alignment.
    """
    crossing = [n for n, one in enumerate(graph.loops) if _ends_within(one, second) == 1]
    kept = [n for n in crossing if optimised.loops[n] is GraphState.IN_MAP]
    others = [graph.loops[n] for n in crossing if optimised.loops[n] is not GraphState.IN_MAP]
    rivals = [loop for loop in (*others, *spare) if _is_apart(loop, optimised, scale)]
    track_m = _common_track_m(graph, (graph.loops[n] for n in kept), second, LONGEST_GAP_M * scale)
    return JoiningLoops(len(kept), track_m, _rival_loops(graph, rivals, second))


def _ends_within(loop: LoopEdge, sessions: frozenset[str]) -> int:
    return (loop.match.session in sessions) + (loop.query.session in sessions)


def _is_apart(loop: LoopEdge, optimised: OptimisedGraph, scale: float) -> bool:
    """Whether a loop puts its submaps elsewhere than the poses do, or these say nothing of it."""
    if not any(loop.match.session in group and loop.query.session in group for group in optimised.components):
        return True
    T_map_match = optimised.T_map_submap[loop.match.session][loop.match.ordinal]
    T_map_query = optimised.T_map_submap[loop.query.session][loop.query.ordinal]
    apart = se3.inverse(T_map_match @ loop.T_match_query) @ T_map_query
    angle = np.arccos(np.clip(0.5 * (np.trace(apart[:3, :3]) - 1.0), -1.0, 1.0))
    return bool(np.linalg.norm(apart[:3, 3]) > RIVAL_APART_M * scale or angle > RIVAL_APART_RAD)


def _rival_loops(graph: PoseGraph, loops: list[LoopEdge], second: frozenset[str]) -> int:
    """The size of the largest set of `loops` between two sessions of which every two agree."""
    largest, pairs = 0, dict[tuple[str, str], list[LoopEdge]]()
    for loop in loops:
        ends = (loop.match.session, loop.query.session)
        first, other = sorted(ends, key=lambda session: session in second)
        pairs.setdefault((first, other), []).append(oriented(loop, first))
    for (first, other), members in pairs.items():
        agree = agreement(members, graph.by_session[first], graph.by_session[other])
        largest = max(largest, len(largest_clique(agree)))
    return largest


def _common_track_m(graph: PoseGraph, loops: Iterable[LoopEdge], second: frozenset[str], longest_gap_m: float) -> float:
    """The way along the sessions `second` between submaps with loops that follow each other closely, to a millimetre:
    steps that add up to a limit shall reach it.
    """
    ends: dict[str, set[int]] = {}
    for loop in loops:
        for node in (loop.match, loop.query):
            if node.session in second:
                ends.setdefault(node.session, set()).add(node.ordinal)
    way_m = sum(_spanned_m(graph, session, ordinals, longest_gap_m) for session, ordinals in sorted(ends.items()))
    return round(way_m, 3)


def _spanned_m(graph: PoseGraph, session: str, ordinals: set[int], longest_gap_m: float) -> float:
    positions: NDArray[np.float64] = graph.by_session[session].T_odom_submap[:, :3, 3]
    gaps = np.diff(travelled_m(positions)[sorted(ordinals)])
    return float(gaps[gaps <= longest_gap_m].sum())
