"""Which neural points were seen through: free-space evidence for the dynamic filter (paper III-B 4, Eq. 6)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.visibility import mark_seen_through, range_image

Array = NDArray[np.float32]


def count_seen_through(
    positions: Array, points: Array, scan_index: NDArray[np.int32], origins: Array
) -> NDArray[np.int32]:
    """How many scans measured farther returns in the direction of each of `positions` (n, 3), all around it.

    `points` (m, 3) were taken from `origins` (s, 3), in the order of their `scan_index` (m,) 0..s-1; everything in the
    frame of the map.
    """
    counts = np.zeros(len(positions), dtype=np.int32)
    for seen, origin in zip(by_scan(points, scan_index, len(origins)), origins, strict=True):
        mark_seen_through(positions, origin, range_image(seen, origin), counts)
    return counts


def by_scan(points: Array, scan_index: NDArray[np.int32], scans: int) -> list[Array]:
    """The `points` (m, 3) of each scan, as of `count_seen_through`."""
    bounds = np.searchsorted(scan_index, np.arange(scans + 1, dtype=scan_index.dtype))
    return [points[start:end] for start, end in pairwise(bounds)]
