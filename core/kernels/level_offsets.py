"""How far above and below each other the points of two surfaces lie where they are seen from above."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop

Array64 = NDArray[np.float64]
Counts = NDArray[np.int64]


def offset_counts(points: Array64, others: Array64, reach_m: float, low_m: float, step_m: float, bins: int) -> Counts:
    """How many pairs of a point of `points` (n, 3) and one of `others` (m, 3), at most `reach_m` apart in the plan,
    have the other so far above the first: (bins,) from `low_m` by `step_m`.
    """
    counts = np.zeros(bins, dtype=np.int64)
    first, second = (np.ascontiguousarray(some[np.argsort(some[:, 0])]) for some in (points, others))
    _count_offsets(first, second, reach_m, low_m, step_m, counts)
    return counts


@loop
def _count_offsets(
    points: Array64, others: Array64, reach_m: float, low_m: float, step_m: float, counts: Counts
) -> None:
    """Add up `counts`; both sets of points are sorted by x."""
    start = 0
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        while start < len(others) and others[start, 0] < x - reach_m:
            start += 1
        other = start
        while other < len(others) and others[other, 0] <= x + reach_m:
            along, aside = others[other, 0] - x, others[other, 1] - y
            if along * along + aside * aside <= reach_m * reach_m:
                row = int(np.floor((others[other, 2] - z - low_m) / step_m))
                if 0 <= row < len(counts):
                    counts[row] += 1
            other += 1
