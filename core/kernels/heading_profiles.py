"""Profiles along all headings: of the faces that look there, and of the plan (docs/decisions/0017)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled, inlined


@compiled
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
    faces_x, faces_y = np.cos(heading), np.sin(heading)
    for vertex in range(len(vertices)):
        if weight[vertex] <= 0.0:
            continue
        x, y, share = vertices[vertex, 0], vertices[vertex, 1], weight[vertex]
        face_x, face_y = faces_x[vertex], faces_y[vertex]
        nearest = int(np.round(heading[vertex] / step))
        for row in range(nearest - spread, nearest + spread + 1):
            cosine, sine = cosines[row + headings], sines[row + headings]
            facing = face_x * cosine + face_y * sine
            if facing <= 0.0:
                continue
            column = int(np.floor((x * cosine + y * sine) / spacing)) + bins // 2
            if 0 <= column < bins:
                fourth = facing * facing * facing * facing
                share_there = share * (fourth if sharpness == 4.0 else facing**sharpness)
                found[row if row >= 0 else row + headings, column] += share_there
    return found


@compiled
def plan_profiles(
    places: NDArray[np.float64], weight: NDArray[np.float64], headings: int, bins: int, spacing: float
) -> NDArray[np.float64]:
    """Weighted counts (headings, bins) along headings over half a turn: the other half mirrors them."""
    found = np.zeros((headings, bins + 2))  # a bin at each end for the outside
    x, y, columns = places[:, 0].copy(), places[:, 1].copy(), np.empty((2, len(places)), dtype=np.int32)
    for row in range(0, headings, 2):  # two at a time: an addition need not wait for the one before
        _fill_columns(x, y, row * np.pi / headings, bins, spacing, columns[0])
        _fill_columns(x, y, (row + 1) * np.pi / headings, bins, spacing, columns[1])
        for place in range(np.uint64(len(places))):
            found[row, np.uint64(columns[0, place])] += weight[place]
            if row + 1 < headings:
                found[row + 1, np.uint64(columns[1, place])] += weight[place]
    return found[:, 1:-1].copy()


@inlined
def _fill_columns(
    x: NDArray[np.float64], y: NDArray[np.float64], angle: float, bins: int, spacing: float, columns: NDArray[np.int32]
) -> None:
    """The bins of places (x, y) along a heading, counted from 1; 0 and `bins` + 1 are outside.

    Without a branch, so that many are done at once.
    """
    cosine, sine, middle = np.cos(angle), np.sin(angle), np.float64(bins // 2 + 1)
    for place in range(np.uint64(len(columns))):
        column = np.floor((x[place] * cosine + y[place] * sine) / spacing) + middle
        columns[place] = np.int32(min(max(column, 0.0), bins + 1.0))
