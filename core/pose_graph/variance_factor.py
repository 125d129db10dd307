"""How much too large a graph states its uncertainties, from small circles: the variance of unit weight of geodesy.

Two loops whose ends lie beside each other close a circle with the few steps between them. By how much it fails to close
can be held against the covariances of its four sides. Classic graphs state a metre and a radian for steps that err by
millimetres: then a wrong loop costs less than any gate, and the map crumples under it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.geometry import se3_rows
from revisit.core.pose_graph.consistency import Circles, inverted, oriented
from revisit.core.pose_graph.graph import LoopEdge, PoseGraph, Trajectory
from revisit.core.pose_graph.support import places, votes

Array64 = NDArray[np.float64]
Ordinals = NDArray[np.int64]

BESIDE = 10
"""Submaps by which the ends of two loops may be apart to close a small circle."""

CIRCLES = 400
"""Circles, at most, between two sessions or within one."""

LEAST_CIRCLES, LEAST_PLACES = 20, 3
"""With fewer circles, or circles at fewer places, nothing is said: of two places one may be taken for another."""

EXPECTED = 5.35
"""Median of the squared errors of circles whose sides state their uncertainty rightly: chi-square, 6 degrees of
freedom.
"""

SAME_WAY = 1e-4
"""Metres and radians by which two drives differ on a way of one recording that was sent twice."""

SLACK = 1000.0
"""Neighbours share errors, drift is not seen in small circles, and aliases close theirs: variances are reduced that are
more than so many times too large, and so far only.
"""

LEAST = 1e-3
"""Made-up graphs without any errors stay solvable."""


def variance_factor(graph: PoseGraph) -> float:
    """The factor for all covariances of the graph: 1 unless they are more than `SLACK` times too large.

    Places vote, not circles: neighbours that take one place for another repeat one measurement, and circles close. So
    do those of a recording that was sent twice, which say nothing.
    """
    groups = [_circles(graph, *group) for group in _groups(graph)]
    errors = np.concatenate([np.zeros(0), *(errors for errors, _ in groups)])
    counts = np.concatenate([np.zeros(0), *(votes(place) for _, place in groups)])
    if len(errors) < LEAST_CIRCLES or round(counts.sum()) < LEAST_PLACES:
        return 1.0
    return float(np.clip(SLACK * _median(errors, counts) / EXPECTED, LEAST, 1.0))


def _median(values: Array64, counts: Array64) -> float:
    """The median of `values` (n,) of which each counts `counts` (n,)."""
    order = np.argsort(values, kind="stable")
    heard = np.cumsum(counts[order])
    return float(values[order[np.searchsorted(heard, 0.5 * heard[-1])]])


def rescaled(graph: PoseGraph, factor: float) -> PoseGraph:
    """The graph with the covariances of its steps and loops multiplied by `factor`."""
    if factor == 1.0:
        return graph
    tracks = (replace(one, step_covariances=factor * one.step_covariances) for one in graph.trajectories)
    loops = (replace(loop, covariance=factor * loop.covariance) for loop in graph.loops)
    return replace(graph, trajectories=tuple(tracks), loops=tuple(loops))


def _groups(graph: PoseGraph) -> Iterator[tuple[str, str, list[LoopEdge]]]:
    """Sessions with the loops between them, or within one, each loop with its match in the first."""
    groups: dict[tuple[str, str], list[LoopEdge]] = {}
    for loop in graph.loops:
        first, second = sorted((loop.match.session, loop.query.session))
        groups.setdefault((first, second), []).append(_forward(loop) if first == second else oriented(loop, first))
    return ((first, second, loops) for (first, second), loops in sorted(groups.items()))


def _forward(loop: LoopEdge) -> LoopEdge:
    return loop if loop.match.ordinal < loop.query.ordinal else inverted(loop)


def _circles(graph: PoseGraph, first: str, second: str, loops: list[LoopEdge]) -> tuple[Array64, Ordinals]:
    """Squared errors (n,), in variances, of small circles, and the place (n,) of each."""
    ends = np.array([(loop.match.ordinal, loop.query.ordinal) for loop in loops])
    pairs = cKDTree(ends).query_pairs(BESIDE, p=np.inf, output_type="ndarray")
    pairs = pairs[np.lexsort(pairs.T[::-1])]
    pairs = pairs[:: -(-len(pairs) // CIRCLES) or 1]
    tracks = graph.by_session[first], graph.by_session[second]
    if first != second and len(pairs):
        pairs = pairs[~_same_way(*tracks, ends, pairs)]
    if not len(pairs):
        return np.zeros(0), np.zeros(0, np.int64)
    poses = np.stack([loop.T_match_query for loop in loops])
    covariances = np.stack([loop.covariance for loop in loops])
    found = places(Circles.of(loops, *tracks), np.arange(len(loops)))
    return squared_errors(poses, covariances, ends, pairs, *map(Side.of, tracks)), found[pairs[:, 0]]


def _same_way(first: Trajectory, second: Trajectory, ends: Ordinals, pairs: Ordinals) -> NDArray[np.bool_]:
    """In which circles (n,) of `pairs` (n, 2) of loops with `ends` (m, 2) both drives went the same way exactly."""
    one, other = ends[pairs[:, 0]].T, ends[pairs[:, 1]].T
    ways = [
        se3_rows.inverse(track.T_odom_submap[here]) @ track.T_odom_submap[there]
        for track, here, there in zip((first, second), one, other, strict=True)
    ]
    apart = se3_rows.log(se3_rows.inverse(ways[0]) @ ways[1])
    return np.asarray(np.abs(apart).max(axis=1) < SAME_WAY)


class Side:
    """A trajectory with the covariances (n, 6, 6) of its poses as steps add them up, in the odometry frame."""

    def __init__(self, poses: Array64, summed: Array64) -> None:
        """`poses` (n, 4, 4) are T_odom_submap."""
        self.poses, self._summed = poses, summed

    @classmethod
    def of(cls, trajectory: Trajectory) -> Side:
        """The side of a trajectory."""
        poses = trajectory.T_odom_submap
        turns = se3_rows.adjoint(poses)
        steps = turns[1:] @ trajectory.step_covariances @ turns[1:].transpose(0, 2, 1)
        return cls(poses, np.concatenate([np.zeros((1, 6, 6)), np.cumsum(steps, axis=0)]))

    def between(self, starts: Ordinals, ends: Ordinals) -> Array64:
        """The covariances (n, 6, 6) of the ways between submaps, in the odometry frame."""
        return np.asarray(self._summed[np.maximum(starts, ends)] - self._summed[np.minimum(starts, ends)])


def squared_errors(
    poses: Array64, covariances: Array64, ends: Ordinals, pairs: Ordinals, first: Side, second: Side
) -> Array64:
    """Squared errors (n,) of circles of `pairs` (n, 2) of loops: along one, beside in `second`, back along the other,
    beside in `first`.

    Of all loops (m): T_match_query (m, 4, 4), covariances (m, 6, 6), ordinals of match and query (m, 2).
    """
    one, other = pairs.T
    (a, b), (c, d) = ends[one].T, ends[other].T
    T_match_second = poses[one] @ se3_rows.inverse(second.poses[b])
    T_match_other = T_match_second @ second.poses[d] @ se3_rows.inverse(poses[other])
    T_match_first = T_match_other @ se3_rows.inverse(first.poses[c])
    covariance = covariances[one].copy()
    for T_match_side, of_side in (
        (T_match_second, second.between(b, d)),
        (T_match_other, covariances[other]),
        (T_match_first, first.between(a, c)),
    ):
        turns = se3_rows.adjoint(T_match_side)
        covariance += turns @ of_side @ turns.transpose(0, 2, 1)
    errors = se3_rows.log(T_match_first @ first.poses[a])
    return np.asarray(np.einsum("ij,ij->i", errors, np.linalg.solve(covariance, errors[..., None])[..., 0]))
