"""The two-point vote: try the planar pose of every two correspondences and keep the one most others agree with."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array64 = NDArray[np.float64]

_STEPS = 180
_STEP = 2.0 * np.pi / _STEPS

_ROUNDING = 1e-9

SHORTEST_BASE = 4.0
"""Two correspondences define a yaw only where their points lie at least so many tolerances apart."""


@numba.njit(cache=True, error_model="numpy", inline="always")
def votes(
    source: Array64, target: Array64, headings: Array64, turn: Array64, shift: Array64, tolerance: float, cosine: float,
    start: int, end: int,
) -> int:  # fmt: skip
    """How many correspondences from `start` to `end` agree with a pose: in position, and in the yaw that each implies.

    source, target and headings are (2, n), coordinates one after the other, so that the loop works on several points
    at once. headings and turn (2,) are cosine and sine of these yaws and of the pose's, shift (2,) its translation in
    metres; two yaws agree where the cosine of their difference is above `cosine`.
    """
    c, s, x, y = turn[0], turn[1], shift[0], shift[1]
    agree, reach = 0, tolerance * tolerance
    for k in range(start, end):
        dx = c * source[0, k] - s * source[1, k] + x - target[0, k]
        dy = s * source[0, k] + c * source[1, k] + y - target[1, k]
        near = dx * dx + dy * dy <= reach
        agree += near & (c * headings[0, k] + s * headings[1, k] > cosine)
    return agree


@numba.njit(cache=True, error_model="numpy")
def _more_votes(
    source: Array64, target: Array64, headings: Array64, turn: Array64, shift: Array64, tolerance: float, cosine: float,
    voters: NDArray[np.int64], least: float,
) -> int:  # fmt: skip
    """As `votes`, of the correspondences from `voters[0]` to `voters[1]`; 0 where the first half of them shows that
    they are no more than `least`.
    """
    start, end = voters[0], voters[1]
    middle = (start + end) // 2
    agree = votes(source, target, headings, turn, shift, tolerance, cosine, start, middle)
    if agree + end - middle <= least:
        return 0
    return agree + votes(source, target, headings, turn, shift, tolerance, cosine, middle, end)


@numba.njit(cache=True, error_model="numpy")
def _voters(directions: Array64, yaw_tolerance: float) -> NDArray[np.int64]:
    """For poses by their yaw, in steps from -pi on: from where to where (steps, 2) those lie that can agree.

    `directions` (n,) are the yaws that are voted with, plus pi, within [0, 2 pi), in order; places count on into a
    second turn of them.
    """
    count, found = len(directions), np.empty((_STEPS, 2), dtype=np.int64)
    twice = np.concatenate((directions, directions + 2.0 * np.pi))
    for step in range(_STEPS):
        low, high = step * _STEP - yaw_tolerance - _ROUNDING, (step + 1) * _STEP + yaw_tolerance + _ROUNDING
        if high - low >= 2.0 * np.pi:
            found[step, 0], found[step, 1] = 0, count
            continue
        turned = 2.0 * np.pi if low < 0.0 else 0.0
        found[step, 0] = np.searchsorted(twice, low + turned)
        found[step, 1] = np.searchsorted(twice, high + turned)
    return found


@numba.njit(cache=True, error_model="numpy")
def best_two_point_pose(
    source: Array64, target: Array64, yaws: Array64, tolerance: float, yaw_tolerance: float
) -> Array64:
    """The pose (yaw, x, y) of two correspondences with the most votes, and their number; all zero where there is none.

    source (n, 2) and target (n, 2) are the corresponding points in metres, yaws (n,) what each implies in radians. A
    pair is tried where its two distances differ by at most `tolerance`, and both yaws by less than `yaw_tolerance` from
    that of the pair. Of poses with equally many votes the first counts.

    Correspondences vote in the order of their yaws, so that those lie together which can agree with a pose.
    """
    best, turn, shift = np.zeros(4), np.empty(2), np.empty(2)
    headings = np.empty((2, len(yaws)))
    headings[0], headings[1] = np.cos(yaws), np.sin(yaws)
    directions = (yaws + np.pi) % (2.0 * np.pi)
    order = np.argsort(directions, kind="mergesort")
    voters, again = _voters(directions[order], yaw_tolerance), np.concatenate((order, order))
    sources, targets = np.ascontiguousarray(source[again].T), np.ascontiguousarray(target[again].T)
    voting = np.ascontiguousarray(headings[:, again])
    cosine = np.cos(yaw_tolerance) if yaw_tolerance < np.pi else -2.0
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
            among = voters[int((np.arctan2(s, c) + np.pi) / _STEP) % _STEPS]
            if among[1] - among[0] <= best[3]:
                continue
            mx, my = 0.5 * (source[i, 0] + source[j, 0]), 0.5 * (source[i, 1] + source[j, 1])
            turn[0], turn[1] = c, s
            shift[0] = 0.5 * (target[i, 0] + target[j, 0]) - (c * mx - s * my)
            shift[1] = 0.5 * (target[i, 1] + target[j, 1]) - (s * mx + c * my)
            agree = _more_votes(sources, targets, voting, turn, shift, tolerance, cosine, among, best[3])
            if agree > best[3]:
                best[0], best[1], best[2], best[3] = np.arctan2(s, c), shift[0], shift[1], agree
    return best
