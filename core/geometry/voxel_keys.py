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
    """The first row of each distinct key (n,) >= 0, in the order of the keys: `np.unique(keys, return_index=True)[1]`.

    Where key and row fit into one number, that is sorted instead of the rows: three times as fast.
    """
    bits = _bits_of_rows(keys)
    if bits is None:
        return np.asarray(np.unique(keys, return_index=True)[1])
    packed = np.sort((keys << bits) | np.arange(len(keys)))
    distinct = np.diff(packed >> bits, prepend=-1) != 0
    return np.asarray(packed[distinct] & ((1 << bits) - 1))


def grouped(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The number (n,) of each key (n,) >= 0 among the distinct ones, in their order, and how often each occurs (m,).

    As `np.unique` gives them; faster in the same way as `first_rows`.
    """
    bits = _bits_of_rows(keys)
    if bits is None:
        _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
        return np.asarray(inverse), np.asarray(counts)
    packed = np.sort((keys << bits) | np.arange(len(keys)))
    distinct = np.diff(packed >> bits, prepend=-1) != 0
    inverse = np.empty(len(keys), np.int64)
    inverse[packed & ((1 << bits) - 1)] = np.cumsum(distinct) - 1
    return inverse, np.diff(np.append(np.flatnonzero(distinct), len(keys)))


def _bits_of_rows(keys: NDArray[np.int64]) -> int | None:
    """How many bits a row takes behind its key, None where key and row do not fit into one number."""
    bits = max(len(keys) - 1, 1).bit_length()
    return None if int(keys.max(initial=0)) >> (63 - bits) else bits


def _ranks(values: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """The rank (n,) of each value among the distinct values, and how many distinct values there are."""
    distinct, ranks = np.unique(values, return_inverse=True)
    return np.asarray(ranks, dtype=np.int64), len(distinct)
