"""Contact of one surface with another, as evidence of an alignment (paper III-E, end)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop
from revisit.core.kernels.normal_equations import CHUNK, add_normal_equations
from revisit.core.kernels.patches import Patches, nearest_patch
from revisit.core.kernels.seen_columns import is_seen

Array64 = NDArray[np.float64]
Counts = NDArray[np.int64]


def touching_rows(
    points: Array64, normals: Array64, patches: Patches, edge: float, reach: float, plane_distance: float,
    facing_alike: float,
) -> tuple[Counts, Array64]:  # fmt: skip
    """For each of `points` (n, 3) the sorted row of its counterpart, -1 for none, and its distance (n,) to its plane.

    The counterpart is the nearest of `patches` (in columns of `edge`) nearer than `reach`; it counts where the point
    lies nearer than `plane_distance` to its plane and the cosine of the normals is above `facing_alike`.
    """
    rows, distances = np.full(len(points), -1, dtype=np.int64), np.zeros(len(points))
    _find_touching(points, normals, patches, edge, reach, plane_distance, facing_alike, rows, distances)
    return rows, distances


@loop
def _find_touching(
    points: Array64, normals: Array64, patches: Patches, edge: float, reach: float, plane_distance: float,
    facing_alike: float, rows: Counts, distances: Array64,
) -> None:  # fmt: skip
    """Fill `rows` and `distances` where a point touches."""
    records, places, keys, grid = patches.records, patches.places, patches.keys, patches.grid
    x_low, y_low, width, depth = patches.low[0], patches.low[1], patches.shape[0], patches.shape[1]
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i = nearest_patch(places, keys, grid, x_low, y_low, width, depth, edge, reach, x, y, z)
        if i < 0:
            continue
        nx, ny, nz = float(records[i, 4]), float(records[i, 5]), float(records[i, 6])
        distance = (x - records[i, 0]) * nx + (y - records[i, 1]) * ny + (z - records[i, 2]) * nz
        facing = normals[n, 0] * nx + normals[n, 1] * ny + normals[n, 2] * nz
        if abs(distance) < plane_distance and facing > facing_alike:
            rows[n], distances[n] = i, distance


def contact_sums(
    points: Array64, normals: Array64, standing: int, T_other_points: Array64, patches: Patches, edge: float,
    reach: float, plane_distance: float, facing_alike: float, slots: NDArray[np.int32], column_edge: float,
) -> tuple[Counts, float, Array64]:  # fmt: skip
    """Contact of a surface that is moved by `T_other_points` (4, 4) with another one.

    Numbers (3,): of its first `standing` points those in columns that the other has seen (`slots`), of these those that
    touch, as in `touching_rows`, and of all its points those that touch; the sum of the squared distances (m^2) of
    these to the planes; and their information (6, 6) of the pose, for residuals of unit variance.
    """
    counts, information, sums = np.zeros(3, dtype=np.int64), np.zeros((6, 6)), np.zeros(7)
    _sum_contact(
        points, normals, standing, T_other_points, patches, edge, reach, plane_distance, facing_alike, slots,
        column_edge, np.ones((9, CHUNK)), counts, information, sums,
    )  # fmt: skip
    return counts, float(sums[6]), information


@loop
def _sum_contact(
    points: Array64, normals: Array64, standing: int, T_other_points: Array64, patches: Patches, edge: float,
    reach: float, plane_distance: float, facing_alike: float, slots: NDArray[np.int32], column_edge: float,
    rows: Array64, counts: Counts, information: Array64, sums: Array64,
) -> None:  # fmt: skip
    """Add up `counts`, `information` and, last of `sums` (7,), the squares. `rows` (9, CHUNK) are for its use, of which
    the residuals and weights are 1.
    """
    records, places, keys, grid, T = patches.records, patches.places, patches.keys, patches.grid, T_other_points
    x_low, y_low, width, depth = patches.low[0], patches.low[1], patches.shape[0], patches.shape[1]
    filled = 0
    for n in range(len(points)):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        seen = n < standing and is_seen(slots, x, y, column_edge)
        counts[0] += seen
        i = nearest_patch(places, keys, grid, x_low, y_low, width, depth, edge, reach, x, y, z)
        if i < 0:
            continue
        nx, ny, nz = float(records[i, 4]), float(records[i, 5]), float(records[i, 6])
        distance = (x - records[i, 0]) * nx + (y - records[i, 1]) * ny + (z - records[i, 2]) * nz
        mx, my, mz = normals[n, 0], normals[n, 1], normals[n, 2]
        facing = (T[0, 0] * mx + T[0, 1] * my + T[0, 2] * mz) * nx + (T[1, 0] * mx + T[1, 1] * my + T[1, 2] * mz) * ny
        facing += (T[2, 0] * mx + T[2, 1] * my + T[2, 2] * mz) * nz
        if abs(distance) >= plane_distance or facing <= facing_alike:
            continue
        counts[1] += seen
        counts[2] += 1
        sums[6] += distance * distance
        rows[0, filled], rows[1, filled], rows[2, filled] = nx, ny, nz
        rows[3, filled], rows[4, filled], rows[5, filled] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
        filled += 1
        if filled == CHUNK:
            add_normal_equations(rows, filled, information, sums)
            filled = 0
    add_normal_equations(rows, filled, information, sums)
    for a in range(6):
        for b in range(a):
            information[b, a] = information[a, b]


def shared_counts(
    points: Array64, normals: Array64, shifts: Array64, patches: Patches, edge: float, reach: float,
    plane_distance: float, facing_alike: float, slots: NDArray[np.int32], column_edge: float,
) -> Counts:  # fmt: skip
    """For each of `shifts` (s, 3) how many points then stand in a seen column, and how many of these touch: (s, 2).

    A point touches as in `touching_rows`; `slots` are those of `seen_columns` of the other surface.
    """
    counts = np.zeros((len(shifts), 2), dtype=np.int64)
    _count_shared(
        points, normals, shifts, patches, edge, reach, plane_distance, facing_alike, slots, column_edge, counts
    )
    return counts


@loop
def _count_shared(
    points: Array64, normals: Array64, shifts: Array64, patches: Patches, edge: float, reach: float,
    plane_distance: float, facing_alike: float, slots: NDArray[np.int32], column_edge: float, counts: Counts,
) -> None:  # fmt: skip
    """Add up `counts`, which are 0."""
    records, places, keys, grid = patches.records, patches.places, patches.keys, patches.grid
    x_low, y_low, width, depth = patches.low[0], patches.low[1], patches.shape[0], patches.shape[1]
    for s in range(len(shifts)):
        for n in range(len(points)):
            x, y, z = points[n, 0] + shifts[s, 0], points[n, 1] + shifts[s, 1], points[n, 2] + shifts[s, 2]
            if not is_seen(slots, x, y, column_edge):
                continue
            counts[s, 0] += 1
            i = nearest_patch(places, keys, grid, x_low, y_low, width, depth, edge, reach, x, y, z)
            if i < 0:
                continue
            nx, ny, nz = float(records[i, 4]), float(records[i, 5]), float(records[i, 6])
            distance = (x - records[i, 0]) * nx + (y - records[i, 1]) * ny + (z - records[i, 2]) * nz
            facing = normals[n, 0] * nx + normals[n, 1] * ny + normals[n, 2] * nz
            counts[s, 1] += abs(distance) < plane_distance and facing > facing_alike
