"""Integer voxels as single numbers, for sorting and grouping."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LARGEST_KEY = 2**63


def voxel_keys(voxels: NDArray[np.integer]) -> NDArray[np.int64]:
    """One key (n,) for each voxel (n, d): equal where the voxels are equal, and in their lexicographic order.

    Keys of one call are comparable, keys of two calls are not. No extent overflows: where the box around the voxels has
    more cells than 64 bits can count, the coordinates are replaced by their ranks.
    """
    keys = np.zeros(len(voxels), dtype=np.int64)
    if len(voxels) == 0:
        return keys
    low = voxels.min(axis=0).astype(np.int64)
    extent = [int(high) - int(least) + 1 for high, least in zip(voxels.max(axis=0), low, strict=True)]
    used = 1
    for axis, size in enumerate(extent):
        if used * size >= _LARGEST_KEY:
            keys, used = _ranks(keys)
        column, count = voxels[:, axis].astype(np.int64) - low[axis], size
        if used * count >= _LARGEST_KEY:
            column, count = _ranks(column)
        keys = keys * count + column
        used *= count
    return keys


def _ranks(values: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """The rank (n,) of each value among the distinct values, and how many distinct values there are."""
    distinct, ranks = np.unique(values, return_inverse=True)
    return np.asarray(ranks, dtype=np.int64), len(distinct)
