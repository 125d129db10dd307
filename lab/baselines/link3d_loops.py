"""The loops of LinK3D, compiled: joining rough returns to clusters one by one, and comparing descriptors."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Steps = NDArray[np.int16]


@numba.njit(inline="always")
def _apart(place: Floats, total: Floats, size: float) -> float:
    """The greatest difference of a place (3,) to the mean of `size` places whose sum is given."""
    greatest = 0.0
    for axis in range(3):
        greatest = max(greatest, abs(place[axis] - total[axis] / size))
    return greatest


@numba.njit(cache=True, error_model="numpy")
def join_clusters(places: Floats, area: Integers, join_m: float) -> Integers:
    """The cluster (e,) of each place (e, 3): x, y and distance, metres, ordered by area.

    A place joins the first cluster of its area whose means are all within `join_m`, or starts one.
    """
    sums, size = np.zeros((len(places), 3)), np.zeros(len(places))
    result = np.empty(len(places), dtype=np.int64)
    first, taken = 0, 0
    for row in range(len(places)):
        if row > 0 and area[row] != area[row - 1]:
            first = taken
        number = first
        while number < taken and _apart(places[row], sums[number], size[number]) >= join_m:
            number += 1
        taken = max(taken, number + 1)
        sums[number] += places[row]
        size[number] += 1.0
        result[row] = number
    return result


@numba.njit(cache=True, error_model="numpy")
def merge_clusters(means: Floats, size: Integers, join_m: float) -> Integers:
    """Into which cluster each one (c,) is merged, by the means (c, 3) of its x, y and distance; one return stays alone.

    From the first on, each takes all later ones within `join_m` that none has taken.
    """
    into = np.arange(len(means))
    for number in range(len(means)):
        if into[number] != number or size[number] < 2:
            continue
        for other in range(number + 1, len(means)):
            if into[other] == other and size[other] > 1 and _apart(means[number], means[other], 1.0) < join_m:
                into[other] = number
    return into


@numba.njit(cache=True, error_model="numpy")
def shared_distances(first: Steps, second: Steps, steps: int) -> Integers:
    """How many distances of two sets of descriptors (k, d), (m, d) are both there and at most `steps` apart: (k, m)."""
    result = np.zeros((len(first), len(second)), dtype=np.int64)
    for i in range(len(first)):
        for j in range(len(second)):
            count = np.int16(0)  # as wide as the distances, so that many are compared at once
            for d in range(first.shape[1]):
                one, other = first[i, d], second[j, d]
                near = (one > np.int16(0)) & (other > np.int16(0)) & (np.int16(abs(one - other)) <= np.int16(steps))
                count = np.int16(count + np.int16(near))
            result[i, j] = count
    return result
