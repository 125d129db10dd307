"""The two-point vote: try the planar pose of every two correspondences and keep the one most others agree with."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array64 = NDArray[np.float64]

_STEPS = 180
_STEP = 2.0 * np.pi / _STEPS

SHORTEST_BASE = 4.0
"""Two correspondences define a yaw only where their points lie at least so many tolerances apart."""


@numba.njit(cache=True, error_model="numpy")
def votes(
    source: Array64, target: Array64, headings: Array64, turn: Array64, shift: Array64, tolerance: float, cosine: float
) -> int:
    """How many correspondences agree with a pose: in position, and in the yaw that each implies.

    source, target and headings are (2, n), coordinates one after the other, so that the loop works on several points
    at once. headings and turn (2,) are cosine and sine of these yaws and of the pose's, shift (2,) its translation in
    metres; two yaws agree where the cosine of their difference is above `cosine`.
    """
    c, s, x, y = turn[0], turn[1], shift[0], shift[1]
    agree = 0
    source_x, source_y, target_x, target_y = source[0], source[1], target[0], target[1]
    heading_x, heading_y = headings[0], headings[1]
    for k in range(len(source_x)):
        dx = c * source_x[k] - s * source_y[k] + x - target_x[k]
        dy = s * source_x[k] + c * source_y[k] + y - target_y[k]
        near = dx * dx + dy * dy <= tolerance * tolerance
        agree += near & (c * heading_x[k] + s * heading_y[k] > cosine)
    return agree


@numba.njit(cache=True, error_model="numpy")
def _most_votes(yaws: Array64, yaw_tolerance: float) -> NDArray[np.int64]:
    """For poses by their yaw, in steps from -pi on: how many of `yaws` (n,) can agree with one in that step at most."""
    most, reach = np.zeros(_STEPS + 1, dtype=np.int64), int(np.ceil(yaw_tolerance / _STEP)) + 1
    for yaw in yaws:
        home = int(np.floor((yaw + np.pi) / _STEP))
        if 2 * reach >= _STEPS:
            most += 1
            continue
        for step in range(home - reach, home + reach + 1):
            most[step % _STEPS] += 1
    most[_STEPS] = max(most[0], most[_STEPS - 1])  # a yaw of pi itself
    return most


@numba.njit(cache=True, error_model="numpy")
def best_two_point_pose(
    source: Array64, target: Array64, yaws: Array64, tolerance: float, yaw_tolerance: float
) -> Array64:
    """The pose (yaw, x, y) of two correspondences with the most votes, and their number; all zero where there is none.

    source (n, 2) and target (n, 2) are the corresponding points in metres, yaws (n,) what each implies in radians. A
    pair is tried where its two distances differ by at most `tolerance`, and both yaws by less than `yaw_tolerance` from
    that of the pair. Of poses with equally many votes the first counts.
    """
    best, turn, shift = np.zeros(4), np.empty(2), np.empty(2)
    headings = np.empty((2, len(yaws)))
    headings[0], headings[1] = np.cos(yaws), np.sin(yaws)
    sources, targets = np.ascontiguousarray(source.T), np.ascontiguousarray(target.T)
    cosine = np.cos(yaw_tolerance) if yaw_tolerance < np.pi else -2.0
    most = _most_votes(yaws, yaw_tolerance)
    for i in range(len(source)):
        for j in range(i + 1, len(source)):
            sx, sy = source[j, 0] - source[i, 0], source[j, 1] - source[i, 1]
            tx, ty = target[j, 0] - target[i, 0], target[j, 1] - target[i, 1]
            length, other = np.sqrt(sx * sx + sy * sy), np.sqrt(tx * tx + ty * ty)
            if length < SHORTEST_BASE * tolerance or abs(length - other) > tolerance:
                continue
            c, s = (sx * tx + sy * ty) / (length * other), (sx * ty - sy * tx) / (length * other)
            if min(c * headings[0, i] + s * headings[1, i], c * headings[0, j] + s * headings[1, j]) <= cosine:
                continue
            if most[int((np.arctan2(s, c) + np.pi) / _STEP)] <= best[3]:
                continue
            mx, my = 0.5 * (source[i, 0] + source[j, 0]), 0.5 * (source[i, 1] + source[j, 1])
            turn[0], turn[1] = c, s
            shift[0] = 0.5 * (target[i, 0] + target[j, 0]) - (c * mx - s * my)
            shift[1] = 0.5 * (target[i, 1] + target[j, 1]) - (s * mx + c * my)
            agree = votes(sources, targets, headings, turn, shift, tolerance, cosine)
            if agree > best[3]:
                best[0], best[1], best[2], best[3] = np.arctan2(s, c), shift[0], shift[1], agree
    return best
