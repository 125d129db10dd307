"""Where one surface touches another, and the point-to-plane ICP that brings them together (paper III-E, end)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.point_columns import PointColumns, span
from revisit.core.kernels.seen_columns import is_seen

Array64 = NDArray[np.float64]

_SMALLEST_STEP_M, _SMALLEST_STEP_RAD = 2e-3, 1e-4
_DAMPING = 1e-6
_WIDER = 1.1  # how much farther ICP looks than it reaches, so that a point without a counterpart is not asked again


@numba.njit(cache=True, error_model="numpy")
def touching_rows(
    points: Array64, normals: Array64, columns: PointColumns, edge: float, other_normals: Array64,
    reach: float, plane_distance: float, facing_alike: float,
) -> tuple[NDArray[np.int64], Array64]:  # fmt: skip
    """For each of `points` (n, 3) the sorted row of its counterpart, -1 for none, and its distance (n,) to its plane.

    The counterpart is the nearest point of `columns` (of edge `edge`) nearer than `reach`; it counts where the point
    lies nearer than `plane_distance` to its tangent plane and the cosine of the normals is above `facing_alike`.
    `other_normals` are in the order of the sorted points.
    """
    rows, distances = np.full(len(points), -1, dtype=np.int64), np.zeros(len(points))
    others, keys, grid = columns.points, columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i = _nearest(others, keys, grid, x_low, y_low, width, depth, edge, reach, x, y, z)
        if i < 0:
            continue
        nx, ny, nz = other_normals[i, 0], other_normals[i, 1], other_normals[i, 2]
        distance = (x - others[i, 0]) * nx + (y - others[i, 1]) * ny + (z - others[i, 2]) * nz
        facing = normals[n, 0] * nx + normals[n, 1] * ny + normals[n, 2] * nz
        if abs(distance) < plane_distance and facing > facing_alike:
            rows[n], distances[n] = i, distance
    return rows, distances


@numba.njit(cache=True, error_model="numpy")
def aligned(
    T_start: Array64, points: Array64, normals: Array64, columns: PointColumns, edge: float, other_normals: Array64,
    reach: float, rounds: int, facing_alike: float, robust: float, fewest: int,
) -> Array64:  # fmt: skip
    """T (4, 4) after up to `rounds` Gauss-Newton steps of point-to-plane ICP from `T_start`.

    Each point counts with its nearest counterpart nearer than `reach` whose normal has a cosine above `facing_alike`
    with its own, by the weight 1 / (1 + (residual / robust)^2)^2. Ends with fewer than `fewest` pairs or a tiny step.

    A point that has moved by less than half the difference of the distances to its nearest and next point since it was
    looked for still has the same nearest one: later steps are small, and most points are not looked for again.
    """
    others, keys, grid = columns.points, columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    pose, hessian, gradient, row = T_start.copy(), np.empty((6, 6)), np.empty(6), np.empty(6)
    found, known = np.full((len(points), 2), -1, dtype=np.int32), np.full((len(points), 4), np.nan)
    for _ in range(rounds):
        hessian[:], gradient[:] = 0.0, 0.0
        pairs = 0
        for n in range(len(points)):
            x, y, z = _moved(pose, points[n, 0], points[n, 1], points[n, 2], 1.0)
            moved = (x - known[n, 0]) ** 2 + (y - known[n, 1]) ** 2 + (z - known[n, 2]) ** 2
            if not moved < known[n, 3]:
                margin = _two_nearest(
                    others, keys, grid, x_low, y_low, width, depth, edge, _WIDER * reach, found[n], x, y, z
                )
                known[n, 0], known[n, 1], known[n, 2], known[n, 3] = x, y, z, margin**2
            i = found[n, 0]
            if i < 0:
                continue
            if (others[i, 0] - x) ** 2 + (others[i, 1] - y) ** 2 + (others[i, 2] - z) ** 2 >= reach * reach:
                continue
            nx, ny, nz = other_normals[i]
            mx, my, mz = _moved(pose, normals[n, 0], normals[n, 1], normals[n, 2], 0.0)
            if mx * nx + my * ny + mz * nz <= facing_alike:
                continue
            residual = (x - others[i, 0]) * nx + (y - others[i, 1]) * ny + (z - others[i, 2]) * nz
            weight = 1.0 / (1.0 + (residual / robust) ** 2) ** 2
            row[0], row[1], row[2] = nx, ny, nz
            row[3], row[4], row[5] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
            pairs += 1
            for a in range(6):
                gradient[a] += weight * row[a] * residual
                for b in range(a + 1):
                    hessian[a, b] += weight * row[a] * row[b]
        if pairs < fewest or _stepped(pose, hessian, gradient):
            break
    return pose


@numba.njit(cache=True, error_model="numpy")
def _stepped(pose: Array64, hessian: Array64, gradient: Array64) -> bool:
    """Whether the step of the normal equations, by which `pose` (4, 4) moves, was a tiny one."""
    _solve(hessian, gradient)
    _step(pose, gradient)
    shift = np.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
    turn = np.sqrt(gradient[3] ** 2 + gradient[4] ** 2 + gradient[5] ** 2)
    return bool(shift < _SMALLEST_STEP_M and turn < _SMALLEST_STEP_RAD)


@numba.njit(inline="always")
def _moved(pose: Array64, x: float, y: float, z: float, shift: float) -> tuple[float, float, float]:
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + shift * pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + shift * pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + shift * pose[2, 3],
    )


@numba.njit(inline="always")
def _nearest(
    points: Array64, keys: NDArray[np.int64], grid: NDArray[np.int32], x_low: int, y_low: int, width: int, depth: int,
    edge: float, reach: float, px: float, py: float, pz: float,
) -> int:  # fmt: skip
    """The sorted row of the point nearest to (px, py, pz) and nearer than `reach`, or -1."""
    nearest, least = -1, reach * reach
    home = int(np.floor(px / edge))
    rings = int(np.ceil(reach / edge))
    for step in range(2 * rings + 1):
        x = home + (step + 1) // 2 * (1 - 2 * (step & 1))  # from the middle outwards
        gap = max(x * edge - px, px - (x + 1) * edge, 0.0)
        if gap * gap >= least:
            continue
        aside = np.sqrt(least - gap * gap)
        y_first, y_last = int(np.floor((py - aside) / edge)), int(np.floor((py + aside) / edge))
        first, last = span(keys, grid, width, depth, x - x_low, y_first - y_low, y_last - y_low)
        for i in range(first, last):
            dx, dy, dz = points[i, 0] - px, points[i, 1] - py, points[i, 2] - pz
            squared = dx * dx + dy * dy + dz * dz
            if squared < least:
                nearest, least = i, squared
    return nearest


@numba.njit(inline="always")
def _two_nearest(
    points: Array64, keys: NDArray[np.int64], grid: NDArray[np.int32], x_low: int, y_low: int, width: int, depth: int,
    edge: float, reach: float, known: NDArray[np.int32], px: float, py: float, pz: float,
) -> float:  # fmt: skip
    """Half of how much farther the next point is than the nearest one to (px, py, pz), both at most `reach`.

    `known` (2,) becomes the sorted rows of both, -1 for none; what it was is tried first, as it may still be near.
    Where nothing is within reach, the answer is how far the nearest one may come before it is within reach / _WIDER.
    """
    first, second, least, next_least = -1, -1, reach * reach, reach * reach
    for k in range(2):
        i = known[k]
        if i >= 0:
            squared = (points[i, 0] - px) ** 2 + (points[i, 1] - py) ** 2 + (points[i, 2] - pz) ** 2
            if squared < least:
                first, second, least, next_least = i, first, squared, least
            elif squared < next_least:
                second, next_least = i, squared
    home = int(np.floor(px / edge))
    rings = int(np.ceil(np.sqrt(next_least) / edge))
    for step in range(2 * rings + 1):
        x = home + (step + 1) // 2 * (1 - 2 * (step & 1))  # from the middle outwards
        gap = max(x * edge - px, px - (x + 1) * edge, 0.0)
        if gap * gap >= next_least:
            continue
        aside = np.sqrt(next_least - gap * gap)
        y_first, y_last = int(np.floor((py - aside) / edge)), int(np.floor((py + aside) / edge))
        begin, end = span(keys, grid, width, depth, x - x_low, y_first - y_low, y_last - y_low)
        for i in range(begin, end):
            dx, dy, dz = points[i, 0] - px, points[i, 1] - py, points[i, 2] - pz
            squared = dx * dx + dy * dy + dz * dz
            if squared < next_least and i != first and i != second:
                if squared < least:
                    first, second, least, next_least = i, first, squared, least
                else:
                    second, next_least = i, squared
    known[0], known[1] = first, second
    if first < 0:
        return reach - reach / _WIDER
    return float(0.5 * (np.sqrt(next_least) - np.sqrt(least)))


@numba.njit(cache=True, error_model="numpy")
def _solve(hessian: Array64, gradient: Array64) -> None:
    """The damped Gauss-Newton step in place of `gradient` (6,), from the lower half of `hessian` (6, 6): Cholesky."""
    damping = 0.0
    for a in range(6):
        damping += _DAMPING * hessian[a, a] / 6.0
    for a in range(6):
        hessian[a, a] += damping
        for b in range(a + 1):
            total = hessian[a, b]
            for k in range(b):
                total -= hessian[a, k] * hessian[b, k]
            hessian[a, b] = np.sqrt(total) if a == b else total / hessian[b, b]
    for a in range(6):
        for k in range(a):
            gradient[a] -= hessian[a, k] * gradient[k]
        gradient[a] /= hessian[a, a]
    for a in range(5, -1, -1):
        for k in range(a + 1, 6):
            gradient[a] -= hessian[k, a] * gradient[k]
        gradient[a] /= hessian[a, a]
    for a in range(6):
        gradient[a] = -gradient[a]


@numba.njit(cache=True, error_model="numpy")
def _step(pose: Array64, tangent: Array64) -> None:
    """`pose` (4, 4) becomes exp(tangent) pose, as `se3.exp` says, tangent (x, y, z, rx, ry, rz)."""
    angle = np.sqrt(tangent[3] ** 2 + tangent[4] ** 2 + tangent[5] ** 2)
    a, b, c = 1.0, 0.5, 1.0 / 6.0
    if angle >= 1e-8:
        a, b = np.sin(angle) / angle, 2.0 * (np.sin(0.5 * angle) / angle) ** 2
        c = (angle - np.sin(angle)) / angle**3
    hat, square = np.zeros((3, 3)), np.zeros((3, 3))
    hat[0, 1], hat[0, 2], hat[1, 2] = -tangent[5], tangent[4], -tangent[3]
    hat[1, 0], hat[2, 0], hat[2, 1] = tangent[5], -tangent[4], tangent[3]
    moved = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                square[i, j] += hat[i, k] * hat[k, j]
    for i in range(3):
        for j in range(3):
            one = 1.0 if i == j else 0.0
            moved[i, 3] += (one + b * hat[i, j] + c * square[i, j]) * tangent[j]
            for k in range(4):
                moved[i, k] += (one + a * hat[i, j] + b * square[i, j]) * pose[j, k]
    pose[:3] = moved[:3]


@numba.njit(cache=True, error_model="numpy")
def shared_counts(
    points: Array64, normals: Array64, shifts: Array64, columns: PointColumns, edge: float, other_normals: Array64,
    reach: float, plane_distance: float, facing_alike: float, slots: NDArray[np.int32], column_edge: float,
) -> NDArray[np.int64]:  # fmt: skip
    """For each of `shifts` (s, 3) how many points then stand in a seen column, and how many of these touch: (s, 2).

    A point touches as in `touching_rows`; `slots` are those of `seen_columns` of the other surface.
    """
    counts = np.zeros((len(shifts), 2), dtype=np.int64)
    others, keys, grid = columns.points, columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    for s in range(len(shifts)):
        for n in range(len(points)):
            x, y, z = points[n, 0] + shifts[s, 0], points[n, 1] + shifts[s, 1], points[n, 2] + shifts[s, 2]
            if not is_seen(slots, x, y, column_edge):
                continue
            counts[s, 0] += 1
            i = _nearest(others, keys, grid, x_low, y_low, width, depth, edge, reach, x, y, z)
            if i < 0:
                continue
            nx, ny, nz = other_normals[i, 0], other_normals[i, 1], other_normals[i, 2]
            distance = (x - others[i, 0]) * nx + (y - others[i, 1]) * ny + (z - others[i, 2]) * nz
            facing = normals[n, 0] * nx + normals[n, 1] * ny + normals[n, 2] * nz
            counts[s, 1] += abs(distance) < plane_distance and facing > facing_alike
    return counts


@numba.njit(cache=True, error_model="numpy")
def plane_information(points: Array64, normals: Array64) -> Array64:
    """The sum (6, 6) over points (n, 3) of the outer products of [normal, point x normal]."""
    total, row = np.zeros((6, 6)), np.empty(6)
    for n in range(len(points)):
        x, y, z, nx, ny, nz = points[n, 0], points[n, 1], points[n, 2], normals[n, 0], normals[n, 1], normals[n, 2]
        row[0], row[1], row[2] = nx, ny, nz
        row[3], row[4], row[5] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
        for a in range(6):
            for b in range(a + 1):
                total[a, b] += row[a] * row[b]
    for a in range(6):
        for b in range(a):
            total[b, a] = total[a, b]
    return total
