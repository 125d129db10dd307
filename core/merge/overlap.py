"""Agreement of the surfaces of two placed groups of submaps, beyond the loops that placed them.

Wrong loops that agree with each other look like right ones to any optimiser of poses. The surfaces know better: where
two groups truly overlap, the points of one lie on the surfaces of the other, and none of them stands where the other
looked through.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.geometry import se3
from revisit.core.implicit_map.visibility import count_seen_through
from revisit.core.merge.evidence import MergeEvidence
from revisit.core.merge.fused import PlacedMap

Array = NDArray[np.float32]

STRETCH_M, STRETCH_PAIRS = 25.0, 3
"""A stretch of the overlap that is judged by itself: a long one that is alike says nothing of one that differs."""

GAP_M = 50.0
"""Farther apart than this are submaps of two drives, or of two overlaps of one."""


def compare_pairs(pairs: Iterable[tuple[PlacedMap, PlacedMap]]) -> MergeEvidence:
    """The points of each submap of a pair against the field and the free space of the other one.

    Everything rests on neural points: rays are those from the middle of a submap to its points.
    """
    residuals: list[NDArray[np.floating]] = [np.zeros(0)]
    far, points, scale = [0], 0, 1.0
    counts: list[list[tuple[int, int]]] = []
    places: list[NDArray[np.float64]] = []
    for pair in pairs:
        counts.append([])
        places.append(pair[0].T_map_submap[:3, 3])
        for one, other in (pair, pair[::-1]):
            positions = seen_from(one, other)
            values, nearest = other.neural_map.sdf(positions)
            resolution, scale = other.neural_map.config.resolution, other.neural_map.frame.scale
            common = np.abs(values[nearest < resolution])
            residuals.append(common * scale)
            far.append(int((common > 0.5 * resolution).sum()))
            points += len(positions)
            seen = _within_view(positions, other)
            counts[-1].append((int(looked_through(positions[seen], other).sum()), int(seen.sum())))
    distances = np.concatenate(residuals)
    seen_through = np.reshape(counts, (-1, 2, 2))
    return MergeEvidence(
        len(distances),
        float(np.median(distances)) if len(distances) else float("inf"),
        sum(far) / len(distances) if len(distances) else 1.0,
        _share(seen_through),
        len(distances) / points if points else 0.0,
        worst_stretch_share=worst_stretch_share(seen_through, np.reshape(places, (-1, 3)), scale),
    )


def worst_stretch_share(seen_through: NDArray[np.int64], places: NDArray[np.float64], scale: float = 1.0) -> float:
    """The largest share of a stretch of pairs whose first submaps lie at `places` (n, 3); see `_share`."""
    return max((_share(seen_through[some]) for some in _stretches(places, scale)), default=0.0)


def _share(seen_through: NDArray[np.int64]) -> float:
    """The larger of both directions' shares: of counts (n, 2, 2), a pair, a direction, looked through and all."""
    through, checked = seen_through.sum(axis=0).T
    return float((through / np.maximum(checked, 1)).max())


def _stretches(places: NDArray[np.float64], scale: float) -> Iterator[slice]:
    """Pairs whose first submaps lie at `places` (n, 3), by all stretches of the way along these.

    Each is STRETCH_M long, or as long as STRETCH_PAIRS pairs are. A gap ends a way.
    """
    apart = np.linalg.norm(np.diff(places, axis=0), axis=1)
    ends = np.flatnonzero(apart > GAP_M * scale) + 1
    for first, last in zip([0, *ends.tolist()], [*ends.tolist(), len(places)], strict=True):
        way = np.concatenate([[0.0], np.cumsum(apart[first : last - 1])])
        for start in range(last - first):
            end = max(start + STRETCH_PAIRS, int(np.searchsorted(way, way[start] + STRETCH_M * scale)))
            if end <= last - first:
                yield slice(first + start, first + end)


def pairs_in_reach(
    first: NDArray[np.float64], second: NDArray[np.float64], reach_m: float, nearest: int = 2, most: int = 200
) -> list[tuple[int, int]]:
    """Which submaps at positions (n, 3) and (m, 3) to compare: of each the `nearest` of the other group within reach.

    Of more than `most` pairs, so many that are spread evenly over all.
    """
    pairs = set[tuple[int, int]]()
    for swapped, (ours, theirs) in enumerate(((first, second), (second, first))):
        gaps, rows = cKDTree(theirs).query(ours, k=min(nearest, len(theirs)), distance_upper_bound=reach_m)
        gaps, rows = gaps.reshape(len(ours), -1), rows.reshape(len(ours), -1)
        for one, place in np.argwhere(np.isfinite(gaps)).tolist():
            other = int(rows[one, place])
            pairs.add((other, one) if swapped else (one, other))
    ordered = sorted(pairs)
    chosen = np.unique(np.linspace(0, len(ordered) - 1, most).round().astype(int)) if len(ordered) > most else None
    return ordered if chosen is None else [ordered[row] for row in chosen]


def seen_from(one: PlacedMap, other: PlacedMap) -> Array:
    """The points (n, 3) of a map in the level frame of another one."""
    in_submap = one.neural_map.frame.points_to_submap(one.neural_map.points.positions)
    return _in_level(in_submap, se3.inverse(other.T_map_submap) @ one.T_map_submap, other)


def points_in_map(one: PlacedMap) -> NDArray[np.float64]:
    """The points (n, 3) of a map in the frame of all of them, metres."""
    in_submap = one.neural_map.frame.points_to_submap(one.neural_map.points.positions)
    return np.asarray(se3.apply(one.T_map_submap, in_submap), dtype=np.float64)


def normals_in_map(one: PlacedMap) -> NDArray[np.float64]:
    """The normals (n, 3) of the points of a map in the frame of all of them."""
    in_submap = one.neural_map.frame.normals_to_submap(one.neural_map.points.normals)
    return np.asarray(in_submap @ one.T_map_submap[:3, :3].T, dtype=np.float64)


def seen_from_map(points: NDArray[np.float64], other: PlacedMap) -> Array:
    """Points (n, 3) of the frame of all maps in the level frame of one of them."""
    return _in_level(points, se3.inverse(other.T_map_submap), other)


def _in_level(points: NDArray[np.floating], T_submap_points: se3.Matrix4, other: PlacedMap) -> Array:
    in_other, frame = points @ T_submap_points[:3, :3].T + T_submap_points[:3, 3], other.neural_map.frame
    return np.asarray((in_other - frame.translation) @ frame.rotation / frame.scale, dtype=np.float32)


def _within_view(positions: Array, other: PlacedMap) -> NDArray[np.bool_]:
    """Which positions (n, 3) are no farther from the middle of a map than half of its points: dense there."""
    reach = np.median(np.linalg.norm(other.neural_map.points.positions, axis=1))
    return np.asarray(np.linalg.norm(positions, axis=1) < reach)


def looked_through(positions: Array, other: PlacedMap) -> NDArray[np.bool_]:
    """Which positions (n, 3) lie before the points of a map in their direction, seen from its middle."""
    points, middle = other.neural_map.points.positions, np.zeros((1, 3), np.float32)
    index = np.zeros(len(points), np.int32)
    return np.asarray(count_seen_through(np.ascontiguousarray(positions), points, index, middle) > 0)
