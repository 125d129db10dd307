"""Measured motions between poses: by how much the poses miss them, and how strongly they pull at these."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inner_sums, loop, sums

Array64 = NDArray[np.float64]
Rows = NDArray[np.int64]

_NEARLY_OPPOSITE, _SMALL = -0.999, 1e-4
"""As in `geometry.se3_rows`."""


def edge_errors(
    first: Rows, second: Rows, T_second_first: Array64, poses: Array64
) -> tuple[Array64, NDArray[np.bool_]]:
    """log(T_second_first @ inverse(pose of the first) @ pose of the second) (e, 6) of poses (n, 4, 4) in these rows;
    and which of them (e,) turn nearly half round, where sines say little of the axis.
    """
    errors, opposite = np.empty((len(first), 6)), np.empty(len(first), dtype=np.bool_)
    rows = np.ascontiguousarray(first), np.ascontiguousarray(second)
    given = np.ascontiguousarray(T_second_first), np.ascontiguousarray(poses)
    _fill_errors(*rows, *given, errors, opposite, np.empty((2, 3, 4)))
    return errors, opposite


def edge_pulls(
    first: Rows, second: Rows, information: Array64, errors: Array64, poses: Array64
) -> tuple[float, Array64]:
    """The sum of squared errors (e, 6) by their information (e, 6, 6), and half its gradient (n, 6) by tangents of the
    map, to first order in the errors: each pulls at its second pose as at its first one, the other way round.
    """
    gradient = np.zeros((len(poses), 6))
    given = np.ascontiguousarray(information), np.ascontiguousarray(errors), np.ascontiguousarray(poses)
    rows = np.ascontiguousarray(first), np.ascontiguousarray(second)
    return _add_pulls(*rows, *given, gradient, np.empty(6)), gradient


def summed(values: Array64, rows: Rows, count: int) -> Array64:
    """Sums (count, ...) of values (e, ...) by row (e,), each in the order of the values."""
    totals = np.zeros((count, *values.shape[1:]))
    given = values.reshape(len(rows), totals[:1].size)
    _add(np.ascontiguousarray(rows), np.ascontiguousarray(given), totals.reshape(count, given.shape[1]))
    return totals


@loop
def _add(rows: Rows, values: Array64, totals: Array64) -> None:
    """Adds each of the values (e, k) to its row of `totals` (n, k)."""
    for e in range(len(rows)):
        of_row, value = totals[rows[e]], values[e]
        for k in range(len(value)):
            of_row[k] += value[k]


@sums
def _fill_errors(
    first: Rows,
    second: Rows,
    T_second_first: Array64,
    poses: Array64,
    errors: Array64,
    opposite: NDArray[np.bool_],
    work: Array64,
) -> None:
    """Fill in `errors` (e, 6), and which of them turn nearly half round; `work` (2, 3, 4) is for use here."""
    motion, missed = work[0], work[1]
    for e in range(len(first)):
        one, other, measured = poses[first[e]], poses[second[e]], T_second_first[e]
        for i in range(3):
            for j in range(3):
                motion[i, j] = one[0, i] * other[0, j] + one[1, i] * other[1, j] + one[2, i] * other[2, j]
            motion[i, 3] = (
                one[0, i] * (other[0, 3] - one[0, 3])
                + one[1, i] * (other[1, 3] - one[1, 3])
                + one[2, i] * (other[2, 3] - one[2, 3])
            )
        for i in range(3):
            for j in range(4):
                total = measured[i, 3] if j == 3 else 0.0
                for k in range(3):
                    total += measured[i, k] * motion[k, j]
                missed[i, j] = total
        opposite[e] = _fill_log(missed, errors[e])


@inner_sums
def _fill_log(transform: Array64, tangent: Array64) -> bool:
    """Fill in the tangent (6,) of a transform (3, 4); whether that turns nearly half round."""
    p = 0.5 * (transform[2, 1] - transform[1, 2])
    q = 0.5 * (transform[0, 2] - transform[2, 0])
    r = 0.5 * (transform[1, 0] - transform[0, 1])
    sine, cosine = math.sqrt(p * p + q * q + r * r), 0.5 * (transform[0, 0] + transform[1, 1] + transform[2, 2] - 1.0)
    angle = math.atan2(sine, cosine)
    scale = angle / sine if sine > 1e-12 else 1.0
    p, q, r = scale * p, scale * q, scale * r
    half = 0.5 * angle
    bend = (1.0 - half * math.cos(half) / math.sin(half)) / (angle * angle) if angle > _SMALL else 1.0 / 12.0
    x, y, z = transform[0, 3], transform[1, 3], transform[2, 3]
    a, b, c = q * z - r * y, r * x - p * z, p * y - q * x
    tangent[0] = x - 0.5 * a + bend * (q * c - r * b)
    tangent[1] = y - 0.5 * b + bend * (r * a - p * c)
    tangent[2] = z - 0.5 * c + bend * (p * b - q * a)
    tangent[3], tangent[4], tangent[5] = p, q, r
    return bool(cosine < _NEARLY_OPPOSITE)


@sums
def _add_pulls(
    first: Rows, second: Rows, information: Array64, errors: Array64, poses: Array64, gradient: Array64, pull: Array64
) -> float:
    """Add the pulls to the `gradient` (n, 6); the sum of squared errors. `pull` (6,) is for use here."""
    cost = 0.0
    for e in range(len(first)):
        pose, before, behind = poses[second[e]], gradient[first[e]], gradient[second[e]]
        for i in range(6):
            total = 0.0
            for j in range(6):
                total += information[e, i, j] * errors[e, j]
            pull[i] = total
            cost += total * errors[e, i]
        x = pose[0, 0] * pull[0] + pose[0, 1] * pull[1] + pose[0, 2] * pull[2]
        y = pose[1, 0] * pull[0] + pose[1, 1] * pull[1] + pose[1, 2] * pull[2]
        z = pose[2, 0] * pull[0] + pose[2, 1] * pull[1] + pose[2, 2] * pull[2]
        p = pose[0, 0] * pull[3] + pose[0, 1] * pull[4] + pose[0, 2] * pull[5] + pose[1, 3] * z - pose[2, 3] * y
        q = pose[1, 0] * pull[3] + pose[1, 1] * pull[4] + pose[1, 2] * pull[5] + pose[2, 3] * x - pose[0, 3] * z
        r = pose[2, 0] * pull[3] + pose[2, 1] * pull[4] + pose[2, 2] * pull[5] + pose[0, 3] * y - pose[1, 3] * x
        pull[0], pull[1], pull[2], pull[3], pull[4], pull[5] = x, y, z, p, q, r
        for i in range(6):
            behind[i] += pull[i]
            before[i] -= pull[i]
    return cost
