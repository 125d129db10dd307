"""Profiles along all headings: of the faces that look there, and of the plan (docs/decisions/0015, 0017)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, error_model="numpy")
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
    angles = np.arange(-headings, headings + 1) * step
    cosines, sines = np.cos(angles), np.sin(angles)
    for vertex in range(len(vertices)):
        if weight[vertex] <= 0.0:
            continue
        x, y, share = vertices[vertex, 0], vertices[vertex, 1], weight[vertex]
        face_x, face_y = np.cos(heading[vertex]), np.sin(heading[vertex])
        nearest = int(np.round(heading[vertex] / step))
        for row in range(nearest - spread, nearest + spread + 1):
            cosine, sine = cosines[row + headings], sines[row + headings]
            facing = face_x * cosine + face_y * sine
            if facing <= 0.0:
                continue
            column = int(np.floor((x * cosine + y * sine) / spacing)) + bins // 2
            if 0 <= column < bins:
                fourth = facing * facing * facing * facing
                found[row % headings, column] += share * (fourth if sharpness == 4.0 else facing**sharpness)
    return found


@numba.njit(cache=True, error_model="numpy")
def plan_profiles(
    places: NDArray[np.float64], weight: NDArray[np.float64], headings: int, bins: int, spacing: float
) -> NDArray[np.float64]:
    """Weighted counts (headings, bins) along headings over half a turn: the other half mirrors them."""
    found = np.zeros((headings, bins))
    x, y, columns = places[:, 0].copy(), places[:, 1].copy(), np.empty(len(places), dtype=np.int64)
    for row in range(headings):
        cosine, sine = np.cos(row * np.pi / headings), np.sin(row * np.pi / headings)
        for place in range(len(places)):  # without a branch, so that many are done at once
            columns[place] = int(np.floor((x[place] * cosine + y[place] * sine) / spacing)) + bins // 2
        for place in range(len(places)):
            if 0 <= columns[place] < bins:
                found[row, columns[place]] += weight[place]
    return found
