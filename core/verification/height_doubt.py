"""How uncertain the height of a pose is: whether other level surfaces of both places could meet (docs/decisions/0081).

Walls say nothing of height. Where cars move along with a robot their roofs are a floor above the ground, which lies
hidden; put on the ground of the other visit they look like it, and residuals are as small as at the right height.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.kernels.level_offsets import offset_counts
from revisit.core.verification.oriented_points import OrientedPoints

_LEVEL = 0.85
_REACH_M = 0.8
_HIGHEST_M = 3.0
_STEP_M = 0.1
_STEPS = 6  # pairs within 0.3 m of a height count for it
_HERE_M = 0.25
_ELSEWHERE_M = 0.55
_LEAST_SHARE = 0.4
_LEAST_PAIRS = 5


def height_doubt_m(query: OrientedPoints, match: OrientedPoints, T_match_query: se3.Matrix4) -> float:
    """Standard deviation, metres, of the height of `T_match_query` (4, 4) beyond its residuals; 0 mostly.

    Both surfaces in their level frames. Counted are pairs of points that look up, one of each surface, less than 0.8 m
    apart in the plan, by how far one lies above the other. At a right height most lie level. Where two fifths as many
    and more agree on another height within 3 m, that could be the right one, as likely as pairs say so.
    """
    moved = se3.apply(T_match_query, query.points[query.normals[:, 2] > _LEVEL])
    level = match.points[match.normals[:, 2] > _LEVEL]
    counts = offset_counts(moved, level, _REACH_M, -_HIGHEST_M, _STEP_M, round(2.0 * _HIGHEST_M / _STEP_M))
    return doubt_of_counts(counts)


def doubt_of_counts(counts: NDArray[np.int64]) -> float:
    """`height_doubt_m` of the pairs (60,) by height, from 3 m below by 0.1 m."""
    agreeing = np.convolve(counts, np.ones(_STEPS, dtype=np.int64), mode="valid")
    height_m = -_HIGHEST_M + _STEP_M * (np.arange(len(agreeing)) + 0.5 * _STEPS)
    here = int(agreeing[np.abs(height_m) <= _HERE_M + 1e-9].max())
    elsewhere = np.where(np.abs(height_m) >= _ELSEWHERE_M - 1e-9, agreeing, 0)
    likeliest = int(elsewhere.argmax())
    there = int(elsewhere[likeliest])
    if there < max(_LEAST_PAIRS, _LEAST_SHARE * here):
        return 0.0
    return float(abs(height_m[likeliest]) * np.sqrt(there / (here + there)))
