"""Sums over the returns of each voxel, scan after scan: records that grow as voxels are filled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.elastic_points import RECORD, insert_returns
from revisit.core.kernels.voxel_table import VoxelTable, empty_slots

_RETURNS_EACH = 8  # in a voxel of a usual submap, or more
_ROOM = 1 << 16


class GatheredReturns:
    """The records of the voxels that returns have filled, in the order in which they were."""

    def __init__(self, resolution: float, expected: int, limit: int) -> None:
        """At most `limit` voxels of edge `resolution` metres; `expected` returns find room without long chains."""
        self._resolution, self._limit = resolution, limit
        self._table = VoxelTable(
            empty_slots(expected // _RETURNS_EACH), np.zeros(0, np.int32), np.zeros((0, 3), np.int32)
        )
        self._records = np.empty((0, RECORD))
        self._size = 0

    @property
    def records(self) -> NDArray[np.float64]:
        """The records so far (n, RECORD), as in `kernels.elastic_points.insert_returns`."""
        return self._records[: self._size]

    def insert(self, points: NDArray[np.float32], origin: NDArray[np.float32], scan: int) -> None:
        """Insert the returns (n, 3) of scan number `scan`, taken from `origin` (3,)."""
        cloud, start = np.ascontiguousarray(points), 0
        while start < len(cloud):
            self._size, start = insert_returns(
                cloud, start, origin, scan, self._table, self._records, self._size, self._resolution, self._limit
            )
            if start < len(cloud):
                self._grow()

    def _grow(self) -> None:
        rows = min(max(2 * len(self._records), _ROOM), self._limit)
        following, voxels = _grown(self._table.following, rows), _grown(self._table.voxels, rows)
        self._records, self._table = _grown(self._records, rows), VoxelTable(self._table.slots, following, voxels)


def _grown(array: NDArray[Any], rows: int) -> NDArray[Any]:
    """The array (n, ...) with room for `rows` rows."""
    grown = np.empty((rows, *array.shape[1:]), dtype=array.dtype)
    grown[: len(array)] = array
    return grown
