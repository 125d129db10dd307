"""Elastic neural points (paper III-B 1 and 3, Eq. 1): insertion, movement, orientation.

A neural point m = (p, q, f, t_c, t_u, mu) lives in one voxel. Its position follows the mean of the returns seen there,
its orientation q turns the local z axis to the surface normal on the side of the sensor, so that the decoder sees the
surface in a frame of its own (Eq. 2) whatever the heading of the robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.elastic_points import FIRST_SCAN, RECORD, VIEW, insert_returns, pooled_covariances
from revisit.core.kernels.oriented_normals import oriented_normals
from revisit.core.kernels.point_columns import columns_of
from revisit.core.kernels.voxel_table import VoxelTable, empty_slots

Array = NDArray[np.float32]

MAX_NEURAL_POINTS = 4_000_000
"""As many as a cloud of the largest size can have."""

_RETURNS_EACH = 8  # in a voxel of a usual submap, or more
_ROOM = 1 << 16


@dataclass(frozen=True)
class NeuralPoints:  # Eq. 1
    """The points of one submap, Eq. 1 without the latent features.

    positions (n, 3) and normals (n, 3) float32; created and updated (n,) int32, the scans of t_c and t_u;
    hits (n,) int32, scans that saw a return here; stability (n,) float32, mu.
    """

    positions: Array
    normals: Array
    created: NDArray[np.int32]
    updated: NDArray[np.int32]
    hits: NDArray[np.int32]
    stability: Array

    def __len__(self) -> int:
        return len(self.positions)

    def subset(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> NeuralPoints:
        """Only the points where `keep` (n,) holds, or those of the rows `keep` (m,)."""
        rows = np.flatnonzero(keep) if keep.dtype == np.bool_ else keep
        return NeuralPoints(
            self.positions.take(rows, axis=0), self.normals.take(rows, axis=0), self.created[rows], self.updated[rows],
            self.hits[rows], self.stability[rows],
        )  # fmt: skip

    @classmethod
    def remembered(cls, positions: Array, normals: Array, hits: NDArray[np.int32], scans: int) -> NeuralPoints:
        """Points read from a store, which keeps no times: each seen from the first to the last of so many scans."""
        created, updated = np.zeros(len(positions), np.int32), np.full(len(positions), scans - 1, np.int32)
        return cls(positions, normals, created, updated, hits, hits.astype(np.float32))


class ElasticAccumulator:
    """Takes scan after scan and keeps one elastic neural point a voxel."""

    def __init__(self, resolution: float, expected: int = 0, limit: int = MAX_NEURAL_POINTS) -> None:
        """At most `limit` voxels of edge `resolution` metres; `expected` returns find room without long chains."""
        self._resolution, self._limit = resolution, limit
        self._table = VoxelTable(
            empty_slots(expected // _RETURNS_EACH), np.zeros(0, np.int32), np.zeros((0, 3), np.int32)
        )
        self._records = np.empty((0, RECORD))
        self._size = 0

    def insert(self, points: Array, origin: Array, scan: int) -> None:
        """Insert the returns (n, 3) of scan number `scan`, taken from `origin` (3,), all in the frame of the map.

        A return in an empty voxel creates a neural point; another moves the point of its voxel (paper III-B 3; why
        none is ever evicted: docs/decisions/0064).
        """
        cloud, start = np.ascontiguousarray(points), 0
        while start < len(cloud):
            self._size, start = insert_returns(
                cloud, start, origin, scan, self._table, self._records, self._size, self._resolution, self._limit
            )
            if start < len(cloud):
                self._grow()

    def __len__(self) -> int:
        return self._size

    def finish(self, most: int = MAX_NEURAL_POINTS) -> NeuralPoints:
        """The points accumulated so far, with their orientations; of more than `most` those nearest to the middle."""
        records = self._records[: self._size]
        positions = (records[:, 1:4] / records[:, :1]).astype(np.float32)
        columns, gathered = columns_of(positions, self._resolution), records
        if len(positions) > most:
            rows = nearest_to_middle(positions, most)
            positions, records = positions[rows], records[rows]
        scans = records[:, FIRST_SCAN:].astype(np.int32)
        spreads = pooled_covariances(positions, gathered, columns, self._resolution)
        normals = oriented_normals(spreads, records[:, VIEW])
        return NeuralPoints(
            positions=positions, normals=normals, created=scans[:, 0].copy(), updated=scans[:, 1].copy(),
            hits=scans[:, 2].copy(), stability=scans[:, 2].astype(np.float32),
        )  # fmt: skip

    def _grow(self) -> None:
        rows = min(max(2 * len(self._records), _ROOM), self._limit)
        following, voxels = _grown(self._table.following, rows), _grown(self._table.voxels, rows)
        self._records, self._table = _grown(self._records, rows), VoxelTable(self._table.slots, following, voxels)


def nearest_to_middle(positions: Array, most: int) -> NDArray[np.int64]:
    """The rows, ascending, of at most so many of `positions` (n, 3): those nearest to the middle of the submap."""
    if len(positions) <= most:
        return np.arange(len(positions))
    squared = np.einsum("ij,ij->i", positions, positions)
    return np.sort(np.argpartition(squared, most)[:most])


def _grown(array: NDArray[Any], rows: int) -> NDArray[Any]:
    """The array (n, ...) with room for `rows` rows."""
    grown = np.empty((rows, *array.shape[1:]), dtype=array.dtype)
    grown[: len(array)] = array
    return grown
