"""Clouds in another frame, without copies in double precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop

Array = NDArray[np.float32]

Rows = NDArray[np.int32]

_NONE = np.empty(0, dtype=np.int32)


def moved_points(T_new_old: NDArray[np.float64], points: Array, *, in_place: bool = False) -> Array:
    """The `points` (n, 3) in another frame: as `se3.apply`, rounded to float32. `in_place` they are where they were.

    NumPy asks for large pages of memory for so large an array, Numba does not.
    """
    given = np.ascontiguousarray(points).reshape(-1)
    moved = given if in_place else np.empty(3 * len(points), dtype=np.float32)
    _move(T_new_old, given, moved)
    return moved.reshape(-1, 3)


@loop
def _move(T_new_old: NDArray[np.float64], given: Array, moved: Array) -> None:
    """Fill `moved` (3 n,). Rows of unsigned numbers are never counted from the end, so that many are done at once."""
    xx, xy, xz, tx = T_new_old[0, 0], T_new_old[0, 1], T_new_old[0, 2], T_new_old[0, 3]
    yx, yy, yz, ty = T_new_old[1, 0], T_new_old[1, 1], T_new_old[1, 2], T_new_old[1, 3]
    zx, zy, zz, tz = T_new_old[2, 0], T_new_old[2, 1], T_new_old[2, 2], T_new_old[2, 3]
    for n in range(len(given) // 3):
        i, j, k = np.uint64(3 * n), np.uint64(3 * n + 1), np.uint64(3 * n + 2)
        x, y, z = np.float64(given[i]), np.float64(given[j]), np.float64(given[k])
        moved[i] = xx * x + xy * y + xz * z + tx
        moved[j] = yx * x + yy * y + yz * z + ty
        moved[k] = zx * x + zy * y + zz * z + tz


def place_returns(
    T_new_scan: NDArray[np.float64],
    points: Array,
    least: float,
    most: float,
    farthest: float,
    placed: Array,
    rows: Rows = _NONE,
) -> int:
    """Put the returns (n, 3) of a scan in another frame into `placed` (at least n, 3); returns how many there are.

    Those whose range is not from `least` to `most` metres are left out, and so are those that lie farther than
    `farthest` from the new origin. `rows` (n,), a number of each return, is thinned in the same way, in its place.
    """
    given, moved = np.ascontiguousarray(points), placed[: len(points)]
    _move(T_new_scan, given.reshape(-1), moved.reshape(-1))
    return _keep_near(given, moved, rows, least, most, farthest)


@loop
def _keep_near(points: Array, moved: Array, rows: Rows, least: float, most: float, farthest: float) -> int:
    """Move the rows of `moved` (n, 3) that stay to its beginning, and those of `rows` (n,) or (0,) with them.

    Returns how many there are.
    """
    count = 0
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        squared = x * x + y * y + z * z
        if not least * least <= squared <= most * most:
            continue
        x, y, z = moved[n, 0], moved[n, 1], moved[n, 2]
        if x * x + y * y + z * z <= farthest * farthest:
            moved[count, 0], moved[count, 1], moved[count, 2] = x, y, z
            if len(rows):
                rows[count] = rows[n]
            count += 1
    return count
