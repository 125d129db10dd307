"""Which neural points were seen through: free-space evidence for the dynamic filter (paper III-B 4, Eq. 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.device import device
from revisit.core.device.description import Returns

Array = NDArray[np.float32]


def count_seen_through(
    positions: Array, points: Array, scan_index: NDArray[np.int32], origins: Array
) -> NDArray[np.int32]:
    """How many scans measured farther returns in the direction of each of `positions` (n, 3), all around it.

    `points` (m, 3) were taken from `origins` (s, 3), in the order of their `scan_index` (m,) 0..s-1; everything in the
    frame of the map.
    """
    return device().description.maps.see_through(positions, returns_of(points, scan_index, origins))


def returns_of(points: Array, scan_index: NDArray[np.int32], origins: Array) -> Returns:
    """The `points` (m, 3) by the scans that they belong to, as of `count_seen_through`."""
    bounds = np.searchsorted(scan_index, np.arange(len(origins) + 1, dtype=scan_index.dtype))
    return Returns(points, bounds, origins)
