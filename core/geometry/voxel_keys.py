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
    used = 1
    for axis in range(voxels.shape[1]):
        column = np.ascontiguousarray(voxels[:, axis], dtype=np.int64)
        low = int(column.min())
        size = int(column.max()) - low + 1
        if used * size >= _LARGEST_KEY:
            keys, used = _ranks(keys)
        column, count = column - low, size
        if used * count >= _LARGEST_KEY:
            column, count = _ranks(column)
        keys = keys * count + column
        used *= count
    return keys


def first_rows(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first row of each distinct key (n,) >= 0, in their order: `np.unique(keys, return_index=True)[1]`."""
    rows = _in_order(keys)
    return rows[_begins(keys, rows)]


def grouped(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The number (n,) of each key (n,) >= 0 among the distinct ones, in their order, and how often each occurs (m,).

    As `np.unique` gives them.
    """
    rows, numbers = _in_order(keys), np.empty(len(keys), np.int64)
    begins = _begins(keys, rows)
    numbers[rows] = np.cumsum(begins) - 1
    return numbers, np.diff(np.append(np.flatnonzero(begins), len(keys)))


def _begins(keys: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether each of the keys in the order of `rows` (n,) is another one than that before it."""
    return np.asarray(np.diff(keys.take(rows), prepend=-1) != 0)


def _in_order(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """The rows (n,) in the order of the keys (n,) >= 0, those of one key ascending: `np.argsort(keys, kind="stable")`.

    By two bytes at a time, the lowest first: these NumPy sorts by counting, in a third of the time for two or three.
    """
    rows, greatest, shift = np.argsort(_digit(keys, 0), kind="stable"), int(keys.max(initial=0)), 16
    while greatest >> shift:
        rows = rows.take(np.argsort(_digit(keys, shift).take(rows), kind="stable"))
        shift += 16
    return rows


def _digit(keys: NDArray[np.int64], shift: int) -> NDArray[np.uint16]:
    return (keys >> shift).astype(np.uint16)


def _ranks(values: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """The rank (n,) of each value among the distinct values, and how many distinct values there are."""
    distinct, ranks = np.unique(values, return_inverse=True)
    return np.asarray(ranks, dtype=np.int64), len(distinct)
