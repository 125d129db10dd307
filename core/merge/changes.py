"""Changes between two days: points that one day has where the other day looked through.

A point of one day that stands in the free space of the other, and that no submap of the other has, is a change. Single
points are noise of the surface; a thing is a cluster of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.merge.evidence import CHANGE_REACH_M, ChangedThing, ChangeKind
from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.overlap import looked_through, points_in_map, seen_from
from revisit.core.merge.things import thing_of

Array64 = NDArray[np.float64]

MOST_CHANGES = 500


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
    labels = thing_of(gone, scale)
    return [thing_around(kind, gone[labels == label]) for label in range(int(labels.max()) + 1)]


def thing_around(kind: ChangeKind, points: Array64) -> ChangedThing:
    """The thing that the points (n, 3) are of."""
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
        near = np.linalg.norm(positions, axis=1) < CHANGE_REACH_M
        through[near] |= looked_through(positions[near], other)
    gone = through & ~there
    return points_in_map(one)[gone]
