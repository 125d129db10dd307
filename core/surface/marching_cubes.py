"""Marching cubes on scattered cells: only where the field was observed, without a dense volume of values.

The case table is derived, not listed: on every face of the cube the crossed edges are joined so that the solid corners
stay on one side, the joints close to loops, and the loops are cut into triangles.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

CORNERS = np.array([[c & 1, (c >> 1) & 1, (c >> 2) & 1] for c in range(8)], dtype=np.int64)
# An edge runs from its lower corner along one axis; 12 of them, named by (lower corner, axis).
_EDGES = [(c, axis) for axis in range(3) for c in range(8) if not (c >> axis) & 1]
# Corners of each face in a cycle that is counter-clockwise seen from outside.
_FACES = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]


@lru_cache(maxsize=1)
def case_table() -> NDArray[np.int8]:
    """Triangles of each of the 256 cases: (256, 5, 3) int8 edges 0..11, -1 where there is no triangle.

    Bit c of a case is set where corner c is solid (negative). Triangles are counter-clockwise seen from free space.
    """
    table = np.full((256, 5, 3), -1, dtype=np.int8)
    for case in range(256):
        triangles = [(loop[0], loop[i], loop[i + 1]) for loop in _loops(case) for i in range(1, len(loop) - 1)]
        for row, triangle in enumerate(triangles):
            table[case, row] = triangle
    return table


def _loops(case: int) -> list[list[int]]:
    """The closed loops of edges around the solid corners of a case."""
    following: dict[int, int] = {}
    for face in _FACES:
        for start in range(4):
            here, there = face[start], face[(start + 1) % 4]
            if not (case >> here) & 1 or (case >> there) & 1:
                continue
            # The contour leaves the solid at edge (here, there); walk back to where this run of solid corners began.
            step = start
            while (case >> face[(step - 1) % 4]) & 1:
                step -= 1
            following[_edge(face[(step - 1) % 4], face[step % 4])] = _edge(here, there)
    loops = []
    while following:
        first, edge = next(iter(following.items()))
        loop = [first]
        del following[first]
        while edge != first:
            loop.append(edge)
            edge = following.pop(edge)
        loops.append(loop)
    return loops


def _edge(a: int, b: int) -> int:
    low = min(a, b)
    return _EDGES.index((low, (a ^ b).bit_length() - 1))


@lru_cache(maxsize=1)
def edge_table() -> NDArray[np.int64]:
    """Lower corner and axis of the 12 edges, (12, 2)."""
    return np.array(_EDGES, dtype=np.int64)
