"""Joins the cells of points that lie near each other: the inner loop of Euclidean clustering (paper III-C)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled, inlined, inner, loop
from revisit.core.kernels.point_columns import PointColumns, span

Rows = NDArray[np.int64]


def join_cells(columns: PointColumns, edge: float, radius: float) -> NDArray[np.int64]:
    """For each of the sorted points (n,) the first cell of its part: cells with points nearer than `radius` are joined.

    `columns` have the edge `edge` = radius / sqrt(3), so that the points of a cell are near each other and those more
    than two cells away are not. Cells are numbered in the order of the sorted points.
    """
    cell_of, starts, heights = _cells(columns.points, columns.keys, edge)
    _join(columns, edge, radius, cell_of, starts, heights, np.arange(len(heights)))
    return np.asarray(cell_of)


@loop
def _join(
    columns: PointColumns, edge: float, radius: float, cell_of: Rows, starts: Rows, heights: Rows, parent: Rows
) -> None:
    """Change `cell_of` (n,) from the cell of each point to the first of its part; `parent` (c,) is 0 to c - 1."""
    points, keys, grid = columns.points, columns.keys, columns.grid
    x_low, y_low, width, depth = columns.low[0], columns.low[1], columns.shape[0], columns.shape[1]
    limit = radius * radius
    for cell in range(len(heights)):
        x = int(np.floor(points[starts[cell], 0] / edge)) - x_low
        y = int(np.floor(points[starts[cell], 1] / edge)) - y_low
        a = _root(parent, cell)
        for column in range(13):
            dx, dy = (column + 2) // 5, (column + 2) % 5 - 2  # (0, 0), (0, 1), (0, 2), (1, -2) ... (2, 2)
            first, last = span(keys, grid, width, depth, x + dx, y + dy, y + dy)
            if first == last:
                continue
            other = cell + 1 if column == 0 else cell_of[first]
            end = cell_of[last - 1] + 1
            while other < end and heights[other] < heights[cell] - 2:
                other += 1
            while other < end and heights[other] <= heights[cell] + 2:
                b = _root(parent, other)
                if a != b and _touch(points, starts, cell, other, limit):
                    parent[max(a, b)] = min(a, b)
                    a = min(a, b)
                other += 1
    for i in range(len(points)):
        cell_of[i] = _root(parent, cell_of[i])


@compiled
def _cells(
    points: NDArray[np.float32], keys: NDArray[np.int64], edge: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """The cell (n,) of each sorted point; the first point (c + 1,) of each cell, n at the end; the z (c,) of each."""
    cell_of = np.empty(len(points), dtype=np.int64)
    starts = np.empty(len(points) + 1, dtype=np.int64)
    heights = np.empty(len(points), dtype=np.int64)
    cells = 0
    for i in range(len(points)):
        z = int(np.floor(points[i, 2] / edge))
        if i == 0 or keys[i] != keys[i - 1] or z != heights[cells - 1]:
            starts[cells], heights[cells] = i, z
            cells += 1
        cell_of[i] = cells - 1
    starts[cells] = len(points)
    return cell_of, starts[: cells + 1], heights[:cells]


@inlined
def _root(parent: NDArray[np.int64], cell: int) -> int:
    while parent[cell] != cell:
        parent[cell] = parent[parent[cell]]
        cell = parent[cell]
    return cell


@inner
def _touch(points: NDArray[np.float32], starts: NDArray[np.int64], a: int, b: int, limit: float) -> bool:
    for i in range(starts[a], starts[a + 1]):
        for j in range(starts[b], starts[b + 1]):
            gap = 0.0
            for k in range(3):
                gap += (points[i, k] - points[j, k]) ** 2
            if gap < limit:
                return True
    return False


def connected_parts(count: int, faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """For each of `count` vertices the first vertex of its part: the vertices of a face (f, 3) belong together."""
    parent = np.arange(count)
    _join_faces(parent, faces)
    return parent


@loop
def _join_faces(parent: Rows, faces: NDArray[np.int32]) -> None:
    for f in range(len(faces)):
        for corner in range(2):
            a, b = _root(parent, faces[f, corner]), _root(parent, faces[f, corner + 1])
            parent[max(a, b)] = min(a, b)
    for vertex in range(len(parent)):
        parent[vertex] = _root(parent, vertex)
