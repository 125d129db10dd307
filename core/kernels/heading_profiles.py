"""Profiles along all headings: of the faces that look there, and of the plan (docs/decisions/0015, 0017)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True)
def face_profiles(
    vertices: NDArray[np.float64],
    heading: NDArray[np.float64],
    weight: NDArray[np.float64],
    headings: int,
    bins: int,
    spacing: float,
    sharpness: float,
) -> NDArray[np.float64]:
    """Weighted counts (headings, bins) along every heading of the vertices within 60 degrees of facing it."""
    found = np.zeros((headings, bins))
    step = 2.0 * np.pi / headings
    spread = headings // 6
    for vertex in range(len(vertices)):
        if weight[vertex] <= 0.0:
            continue
        nearest = int(np.round(heading[vertex] / step))
        for row in range(nearest - spread, nearest + spread + 1):
            angle = row * step
            facing = np.cos(heading[vertex] - angle)
            if facing <= 0.0:
                continue
            along = vertices[vertex, 0] * np.cos(angle) + vertices[vertex, 1] * np.sin(angle)
            column = int(np.floor(along / spacing)) + bins // 2
            if 0 <= column < bins:
                found[row % headings, column] += weight[vertex] * facing**sharpness
    return found


@numba.njit(cache=True)
def plan_profiles(
    places: NDArray[np.float64], weight: NDArray[np.float64], headings: int, bins: int, spacing: float
) -> NDArray[np.float64]:
    """Weighted counts (headings, bins) along headings over half a turn: the other half mirrors them."""
    found = np.zeros((headings, bins))
    for row in range(headings):
        cosine, sine = np.cos(row * np.pi / headings), np.sin(row * np.pi / headings)
        for place in range(len(places)):
            column = int(np.floor((places[place, 0] * cosine + places[place, 1] * sine) / spacing)) + bins // 2
            if 0 <= column < bins:
                found[row, column] += weight[place]
    return found
