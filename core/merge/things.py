"""Things: clusters of points that are large enough to be more than noise of a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Array64 = NDArray[np.float64]

SAME_THING_M = 0.8
LEAST_POINTS = 16
LEAST_HEIGHT_M = 0.4
"""Lengths in a scene of the size of a street: points nearer than this belong to one thing; a thing has so many points
and is so high."""


_BITS = 21
_AXIS = (1 << _BITS) - 1


def voxels_of(points: Array64, edge_m: float) -> NDArray[np.int64]:
    """A number (n,) for the voxel of each of the points (n, 3): the same in every call, within 2^21 voxels."""
    columns = np.floor(points / edge_m).astype(np.int64) & _AXIS
    return np.asarray(columns[:, 0] << 2 * _BITS | columns[:, 1] << _BITS | columns[:, 2])


def are_in(numbers: NDArray[np.int64], some: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of the numbers (n,) are among `some` (m,), which are sorted and not none."""
    return np.asarray(some[np.searchsorted(some[:-1], numbers)] == numbers)


def thing_of(points: Array64, scale: float) -> NDArray[np.int64]:
    """The number (n,) of the thing that each of the points (n, 3) in metres belongs to; -1 for those of none."""
    if not len(points):
        return np.zeros(0, np.int64)
    links = cKDTree(points).query_pairs(SAME_THING_M * scale, output_type="ndarray")
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(len(points), len(points)))
    count, labels = connected_components(graph, directed=False)
    low, high = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(low, labels, points[:, 2])
    np.maximum.at(high, labels, points[:, 2])
    is_thing = (np.bincount(labels, minlength=count) >= LEAST_POINTS) & (high - low >= LEAST_HEIGHT_M * scale)
    numbers = np.where(is_thing, np.cumsum(is_thing) - 1, -1)
    return np.asarray(numbers[labels], dtype=np.int64)


def thing_of_many(points: Array64, edge_m: float, scale: float) -> NDArray[np.int64]:
    """As `thing_of`, of points that many submaps saw: those in one voxel of this edge count as one."""
    if not len(points):
        return np.zeros(0, np.int64)
    voxels, of_point = np.unique(np.floor(points / edge_m).astype(np.int64), axis=0, return_inverse=True)
    middles: Array64 = (voxels.astype(np.float64) + 0.5) * edge_m
    return np.asarray(thing_of(middles, scale)[of_point.ravel()], dtype=np.int64)
