"""Vertical columns in which a place has seen anything: a hash table, and the lowest point of each."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop

Array64 = NDArray[np.float64]

_NOWHERE = -(2**31)


class SeenColumns(NamedTuple):
    """slots (s, 2) int32, the column (x, y) entered there or _NOWHERE; lowest (s,), the height of its lowest point."""

    slots: NDArray[np.int32]
    lowest: Array64


def seen_columns(points: Array64, edge: float) -> SeenColumns:
    """The columns of `edge` metres in which any of `points` (n, 3) lies."""
    size = 64
    while size < 2 * len(points):
        size *= 2
    slots, lowest = np.full((size, 2), _NOWHERE, dtype=np.int32), np.full(size, np.inf)
    return _without_room(slots, lowest, _enter_all(points, edge, slots, lowest))


@loop
def _enter_all(points: Array64, edge: float, slots: NDArray[np.int32], lowest: Array64) -> int:
    """Enter the columns of `points`; returns how many there are."""
    count = 0
    for n in range(len(points)):
        x, y = int(np.floor(points[n, 0] / edge)), int(np.floor(points[n, 1] / edge))
        slot = slot_of(slots, x, y)
        count += slots[slot, 0] == _NOWHERE
        slots[slot, 0], slots[slot, 1] = x, y
        lowest[slot] = min(lowest[slot], points[n, 2])
    return count


def _without_room(slots: NDArray[np.int32], lowest: Array64, count: int) -> SeenColumns:
    """The same `count` columns in a table of no more than eight slots for each: a place keeps it, a search reads it."""
    size = 64
    while size < 4 * count:
        size *= 2
    kept = SeenColumns(np.full((size, 2), _NOWHERE, dtype=np.int32), np.full(size, np.inf))
    _enter_again(slots, lowest, kept.slots, kept.lowest)
    return kept


@loop
def _enter_again(slots: NDArray[np.int32], lowest: Array64, kept: NDArray[np.int32], kept_lowest: Array64) -> None:
    """Copy the entries of `slots` into the empty table of `kept`."""
    for n in range(len(slots)):
        x, y = int(slots[n, 0]), int(slots[n, 1])
        if x != _NOWHERE:
            slot = slot_of(kept, x, y)
            kept[slot, 0], kept[slot, 1], kept_lowest[slot] = x, y, lowest[n]


def heights_above(points: Array64, T_columns_points: Array64, columns: SeenColumns, edge: float) -> Array64:
    """By how much the lowest point of each column lies above the lowest one of `points` (n, 3) moved into it.

    Of the columns that both have, in no order. `T_columns_points` is (4, 4).
    """
    lowest, entered = np.full(len(columns.slots), np.inf), np.empty(len(columns.slots), dtype=np.int64)
    gaps = np.empty(len(columns.slots))
    return gaps[: _measure_heights(points, T_columns_points, columns, edge, lowest, entered, gaps)]


@loop
def _measure_heights(
    points: Array64, T_columns_points: Array64, columns: SeenColumns, edge: float, lowest: Array64,
    entered: NDArray[np.int64], gaps: Array64,
) -> int:  # fmt: skip
    """Fill the first of `gaps`; returns how many. `lowest` (s,), infinite, and `entered` (s,) are for its use."""
    T, slots, heights = T_columns_points, columns.slots, columns.lowest
    count = 0
    for n in range(len(points)):
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        slot = slot_of(slots, int(np.floor(x / edge)), int(np.floor(y / edge)))
        if slots[slot, 0] == _NOWHERE:
            continue
        if lowest[slot] == np.inf:
            entered[count] = slot
            count += 1
        lowest[slot] = min(lowest[slot], T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3])
    for k in range(count):
        gaps[k] = heights[entered[k]] - lowest[entered[k]]
    return count


@inlined
def is_seen(slots: NDArray[np.int32], x: float, y: float, edge: float) -> bool:
    """Whether (x, y) lies in a column that is entered in `slots`."""
    slot = slot_of(slots, int(np.floor(x / edge)), int(np.floor(y / edge)))
    return bool(slots[slot, 0] != _NOWHERE)


@inlined
def slot_of(slots: NDArray[np.int32], x: int, y: int) -> int:
    """Where column (x, y) is entered in `slots` (s, 2), or would be; s is a power of two."""
    mixed = (x * 0x9E3779B1) ^ (y * 0x85EBCA77)
    slot = (mixed ^ (mixed >> 15)) & (len(slots) - 1)
    while slots[slot, 0] != _NOWHERE and (slots[slot, 0] != x or slots[slot, 1] != y):
        slot = (slot + 1) & (len(slots) - 1)
    return slot
