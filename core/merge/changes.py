"""Changes between two days: points that one day has where the other day looked through.

A point of one day that stands in the free space of the other, and that no submap of the other has, is a change. Single
points are noise of the surface; a thing is a cluster of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from revisit.core.geometry import se3
from revisit.core.merge.evidence import ChangedThing, ChangeKind
from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.overlap import looked_through, seen_from

Array64 = NDArray[np.float64]

SAME_THING_M = 0.8
LEAST_POINTS = 16
LEAST_HEIGHT_M = 0.4
MOST_CHANGES = 500
NEAR_M = 25.0
"""Lengths in a scene of the size of a street: points nearer than this belong to one thing; a thing has so many points
and is so high; changes farther from the middle of the submap that looked through are not looked for."""


def changes_between(pairs: Sequence[tuple[PlacedMap, PlacedMap]]) -> list[ChangedThing]:
    """Changes from the first day to the second, the largest first; each pair has a submap of both days."""
    found = [
        *_things(ChangeKind.VANISHED, pairs),
        *_things(ChangeKind.APPEARED, [(second, first) for first, second in pairs]),
    ]
    return sorted(found, key=lambda one: (-one.points, one.kind, one.centre_m))[:MOST_CHANGES]


def _things(kind: ChangeKind, pairs: Sequence[tuple[PlacedMap, PlacedMap]]) -> list[ChangedThing]:
    scale = pairs[0][0].neural_map.frame.scale if pairs else 1.0
    gone = _gone_points(pairs)
    if not len(gone):
        return []
    links = cKDTree(gone).query_pairs(SAME_THING_M * scale, output_type="ndarray")
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(len(gone), len(gone)))
    _, labels = connected_components(graph, directed=False)
    clusters = [gone[labels == label] for label in np.flatnonzero(np.bincount(labels) >= LEAST_POINTS)]
    high = [one for one in clusters if np.ptp(one[:, 2]) >= LEAST_HEIGHT_M * scale]
    return [_thing(kind, one) for one in high]


def _thing(kind: ChangeKind, points: Array64) -> ChangedThing:
    low, high = points.min(axis=0), points.max(axis=0)
    centre, extent = (0.5 * (low + high)).tolist(), (high - low).tolist()
    return ChangedThing(kind, (centre[0], centre[1], centre[2]), (extent[0], extent[1], extent[2]), len(points))


def _gone_points(pairs: Sequence[tuple[PlacedMap, PlacedMap]]) -> Array64:
    """Points (n, 3), in the map, of the first of each pair that the second looked through and none of its day has."""
    by_map: dict[int, tuple[PlacedMap, list[PlacedMap]]] = {}
    for one, other in pairs:
        by_map.setdefault(id(one.neural_map), (one, []))[1].append(other)
    parts = [_gone_from(one, others) for one, others in by_map.values()]
    return np.concatenate([np.zeros((0, 3)), *parts])


def _gone_from(one: PlacedMap, others: list[PlacedMap]) -> Array64:
    count = len(one.neural_map.points)
    through, there = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    for other in others:
        positions = seen_from(one, other)
        _, nearest = other.neural_map.sdf(positions)
        there |= nearest < other.neural_map.config.resolution
        near = np.linalg.norm(positions, axis=1) < NEAR_M
        through[near] |= looked_through(positions[near], other)
    gone = through & ~there
    in_submap = one.neural_map.frame.points_to_submap(one.neural_map.points.positions[gone])
    return np.asarray(se3.apply(one.T_map_submap, in_submap), dtype=np.float64)
