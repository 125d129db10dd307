"""The two-point vote: try the planar pose of every two correspondences and keep the one most others agree with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, inner, inner_sums, loop

Array64 = NDArray[np.float64]
Array32 = NDArray[np.float32]
Voters = NDArray[np.int64]

_STEPS = 180
_ROUNDING = 1e-6  # of a yaw, radians
_BLUR = 1e-3  # metres: more than the coordinates of a place lose in single precision

SHORTEST_BASE = 4.0
"""Two correspondences define a yaw only where their points lie at least so many tolerances apart."""


def best_two_point_pose(
    source: Array64, target: Array64, yaws: Array64, tolerance: float, yaw_tolerance: float
) -> Array64:
    """The pose (yaw, x, y) of two correspondences with the most votes, and their number; all zero where there is none.

    source (n, 2) and target (n, 2) are the corresponding points in metres, yaws (n,) the yaw of each in radians. A
    pair is tried where its two distances differ by at most `tolerance`, and both yaws by less than `yaw_tolerance` from
    that of the pair. Of poses with equally many votes the first counts.

    Correspondences vote in the order of their yaws, so that those lie together which can agree with a pose.
    """
    best, pairs, directions = np.zeros(5), np.empty((6, len(source))), (yaws + np.pi) % (2.0 * np.pi)
    order = np.argsort(directions, kind="stable")
    _pair_up(source, target, yaws, pairs)
    voting = np.ascontiguousarray(pairs[:, np.append(order, order)])
    cosine = math.cos(yaw_tolerance) if yaw_tolerance < np.pi else -2.0
    voters = _voters(directions[order], yaw_tolerance)
    _vote(pairs, voting, voting[:4].astype(np.float32), voters, tolerance, cosine, np.empty((2, len(source))), best)
    return np.array([math.atan2(best[1], best[0]) if best[4] else 0.0, best[2], best[3], best[4]])


@loop
def _pair_up(source: Array64, target: Array64, yaws: Array64, pairs: Array64) -> None:
    """Fill `pairs` (6, n): source and target, cosine and sine of the yaw of each correspondence."""
    for k in range(len(source)):
        pairs[0, k], pairs[1, k] = source[k, 0], source[k, 1]
        pairs[2, k], pairs[3, k] = target[k, 0], target[k, 1]
        pairs[4, k], pairs[5, k] = np.cos(yaws[k]), np.sin(yaws[k])


@loop
def _vote(
    pairs: Array64, voting: Array64, about: Array32, voters: Voters, tolerance: float, cosine: float, lengths: Array64,
    best: Array64,
) -> None:  # fmt: skip
    """Fill `best` (5,), which is 0: cosine and sine of the yaw, x, y, votes. `lengths` (2, n) is for its use.

    pairs (6, n): source and target, cosine and sine of the yaw of each correspondence; voting (6, 2 n) the same in the
    order of the yaws, twice; about (4, 2 n) the first of these. Most poses are left out after a count of those near in
    single precision, a little farther than `tolerance`: at least as many as vote.
    """
    reach, wide = tolerance * tolerance, np.float32((tolerance + _BLUR) ** 2)
    for i in range(pairs.shape[1]):
        ax, ay, bx, by = pairs[0, i], pairs[1, i], pairs[2, i], pairs[3, i]
        _measure_lengths(pairs, i, lengths)
        for j in range(i + 1, pairs.shape[1]):
            length, other = lengths[0, j], lengths[1, j]
            if (length < SHORTEST_BASE * tolerance) | (abs(length - other) > tolerance):
                continue
            sx, sy, tx, ty = pairs[0, j] - ax, pairs[1, j] - ay, pairs[2, j] - bx, pairs[3, j] - by
            c, s = (sx * tx + sy * ty) / (length * other), (sx * ty - sy * tx) / (length * other)
            if min(c * pairs[4, i] + s * pairs[5, i], c * pairs[4, j] + s * pairs[5, j]) <= cosine:
                continue
            step = _step(c, s)
            start, end = voters[step, 0], voters[step, 1]
            if end - start <= best[4]:
                continue
            mx, my = 0.5 * (ax + pairs[0, j]), 0.5 * (ay + pairs[1, j])
            x, y = 0.5 * (bx + pairs[2, j]) - (c * mx - s * my), 0.5 * (by + pairs[3, j]) - (s * mx + c * my)
            if _near(about, np.float32(c), np.float32(s), np.float32(x), np.float32(y), wide, start, end) <= best[4]:
                continue
            agree = _votes(voting, c, s, x, y, reach, cosine, start, end)
            if agree > best[4]:
                best[0], best[1], best[2], best[3], best[4] = c, s, x, y, agree


@inner
def _measure_lengths(pairs: Array64, i: int, lengths: Array64) -> None:
    """Fill `lengths` (2, n): how far the later correspondences lie from the one of row i, at the source and target."""
    for j in range(np.uint64(i + 1), np.uint64(pairs.shape[1])):
        sx, sy = pairs[0, j] - pairs[0, i], pairs[1, j] - pairs[1, i]
        tx, ty = pairs[2, j] - pairs[2, i], pairs[3, j] - pairs[3, i]
        lengths[0, j], lengths[1, j] = np.sqrt(sx * sx + sy * sy), np.sqrt(tx * tx + ty * ty)


@inner_sums
def _near(
    about: Array32, c: np.float32, s: np.float32, x: np.float32, y: np.float32, reach: np.float32, start: int, end: int
) -> np.float32:
    """How many correspondences from `start` to `end` a pose brings together within the root of `reach`, about."""
    near = np.float32(0.0)
    for k in range(np.uint64(start), np.uint64(end)):
        dx = c * about[0, k] - s * about[1, k] + (x - about[2, k])
        dy = s * about[0, k] + c * about[1, k] + (y - about[3, k])
        near += np.float32(1.0) if dx * dx + dy * dy <= reach else np.float32(0.0)
    return near


@inner
def _votes(
    voting: Array64, c: float, s: float, x: float, y: float, reach: float, cosine: float, start: int, end: int
) -> int:
    """How many correspondences from `start` to `end` agree with a pose: in position, and in the yaw that each implies.

    c and s are cosine and sine of the pose's yaw, x and y its translation in metres; two yaws agree where the cosine of
    their difference is above `cosine`.
    """
    agree = 0
    for k in range(np.uint64(start), np.uint64(end)):
        dx = c * voting[0, k] - s * voting[1, k] + x - voting[2, k]
        dy = s * voting[0, k] + c * voting[1, k] + y - voting[3, k]
        agree += (dx * dx + dy * dy <= reach) & (c * voting[4, k] + s * voting[5, k] > cosine)
    return agree


def _voters(directions: Array64, yaw_tolerance: float) -> Voters:
    """For poses by the step of their yaw: from where to where (steps, 2) those lie that can agree.

    `directions` (n,) are the yaws that are voted with, plus pi, within [0, 2 pi), in order; places count on into a
    second turn of them.
    """
    bounds = np.empty((_STEPS, 2))
    _find_bounds(yaw_tolerance, bounds)
    found = np.searchsorted(np.append(directions, directions + 2.0 * np.pi), bounds)
    found[np.isinf(bounds[:, 0])] = 0, len(directions)
    return found


@loop
def _find_bounds(yaw_tolerance: float, bounds: Array64) -> None:
    """Fill `bounds` (steps, 2): between which directions those lie that can agree, infinite where all can."""
    for step in range(_STEPS):
        low, high = _first_yaw(step) - yaw_tolerance - _ROUNDING, _first_yaw(step + 1) + yaw_tolerance + _ROUNDING
        if high - low >= 2.0 * np.pi:
            bounds[step, 0], bounds[step, 1] = -np.inf, np.inf
            continue
        turned = np.pi if low >= -np.pi else 3.0 * np.pi
        bounds[step, 0], bounds[step, 1] = low + turned, high + turned


@inlined
def _step(c: float, s: float) -> int:
    """The step of a yaw of cosine `c` and sine `s`: where it goes through the square |x| + |y| = 1, which needs no
    arcus tangent.
    """
    along = s / (abs(c) + abs(s))
    if c < 0.0:
        along = (2.0 if s >= 0.0 else -2.0) - along
    return min(int((along + 2.0) * (0.25 * _STEPS)), _STEPS - 1)


@inlined
def _first_yaw(step: int) -> float:
    """The yaw within [-pi, pi] at which a step begins."""
    if step == 0:
        return -np.pi
    along = 4.0 * step / _STEPS - 2.0
    beside = 1.0 - abs(along)
    return float(np.arctan2(along if beside >= 0.0 else np.sign(along) * 2.0 - along, beside))
