"""Normals of surfaces: the direction of least variance of the returns, on the side of the sensor (paper III-B 1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, loop

Array64 = NDArray[np.float64]

NORMAL_PRIOR = 0.05
SWEEPS = 12
_LANES = 64
NEGLIGIBLE = 1e-18  # of the squared values: axes are right within a billionth


def oriented_normals(covariances: Array64, views: Array64) -> NDArray[np.float32]:
    """Unit normals (n, 3) towards the sensor: least variance, with a prior for the viewing direction.

    covariances (n, 3, 3), of any scale; views (n, 3) towards the sensor, of any length. The prior decides where returns
    form a line (one beam on a wall) or a single spot.
    """
    normals = np.empty((len(covariances), 3), dtype=np.float32)
    _orient(covariances, views, np.empty((6, _LANES)), np.empty((9, _LANES)), np.empty((3, _LANES)), normals)
    return normals


@loop
def _orient(
    covariances: Array64, views: Array64, matrix: Array64, axes: Array64, view: Array64, normals: NDArray[np.float32]
) -> None:
    """Fill `normals` (n, 3); `matrix` (6, _LANES), `axes` (9, _LANES) and `view` (3, _LANES) are for its use.

    So many matrices are done side by side: diagonal and upper triangle (00, 11, 22, 01, 02, 12) of each; of
    its axes, row 3 a + b is component a of axis b.
    """
    for start in range(0, len(covariances), _LANES):
        count = np.uint64(min(_LANES, len(covariances) - start))
        _load(covariances, views, np.uint64(start), count, matrix, axes, view)
        for _ in range(SWEEPS):
            if _clear_diagonal(matrix, count) == count:
                break
            _rotate(matrix, axes, count, 0, 1)
            _rotate(matrix, axes, count, 0, 2)
            _rotate(matrix, axes, count, 1, 2)
        for k in range(count):
            first, second, third = matrix[0, k], matrix[1, k], matrix[2, k]
            least = 1 if second < first else 0
            least = 2 if third < min(first, second) else least
            x, y, z = axes[least, k], axes[3 + least, k], axes[6 + least, k]
            sign = -1.0 if x * view[0, k] + y * view[1, k] + z * view[2, k] < 0.0 else 1.0
            i = np.uint64(start) + k
            normals[i, 0], normals[i, 1], normals[i, 2] = sign * x, sign * y, sign * z


@inlined
def _load(
    covariances: Array64, views: Array64, start: np.uint64, count: np.uint64, matrix: Array64, axes: Array64,
    view: Array64,
) -> None:  # fmt: skip
    """The matrices of `count` points from row `start` on, of trace 1 and with the prior, and no turn yet."""
    for k in range(count):
        i = start + k
        length = np.sqrt(views[i, 0] ** 2 + views[i, 1] ** 2 + views[i, 2] ** 2) + 1e-12
        for a in range(3):
            view[a, k] = views[i, a] / length
    for k in range(count):
        i = start + k
        spread = covariances[i, 0, 0] + covariances[i, 1, 1] + covariances[i, 2, 2] + 1e-9
        for a in range(3):
            matrix[a, k] = covariances[i, a, a] / spread - NORMAL_PRIOR * view[a, k] * view[a, k] + NORMAL_PRIOR
        matrix[3, k] = covariances[i, 0, 1] / spread - NORMAL_PRIOR * view[0, k] * view[1, k]
        matrix[4, k] = covariances[i, 0, 2] / spread - NORMAL_PRIOR * view[0, k] * view[2, k]
        matrix[5, k] = covariances[i, 1, 2] / spread - NORMAL_PRIOR * view[1, k] * view[2, k]
    for a in range(9):
        for k in range(count):
            axes[a, k] = 1.0 if a % 4 == 0 else 0.0


@inlined
def _clear_diagonal(matrix: Array64, count: np.uint64) -> int:
    """Make entries zero that are negligible beside the diagonals; return of how many."""
    found = 0
    for k in range(count):
        aside = matrix[3, k] ** 2 + matrix[4, k] ** 2 + matrix[5, k] ** 2
        diagonal = aside <= NEGLIGIBLE * (matrix[0, k] ** 2 + matrix[1, k] ** 2 + matrix[2, k] ** 2)
        found += 1 if diagonal else 0
        for a in range(3, 6):
            matrix[a, k] = 0.0 if diagonal else matrix[a, k]
    return found


@inlined
def _rotate(matrix: Array64, axes: Array64, count: np.uint64, p: int, q: int) -> None:
    """Jacobi's method: turn in the plane of axes p and q so that the matrices' element (p, q) becomes zero.

    Without a branch, so that several are done at once: where it is zero already, the turn is none.
    """
    pq, r = 2 + p + q, 3 - p - q
    rp, rq = 2 + r + p, 2 + r + q
    for k in range(count):
        off = matrix[pq, k]
        ratio = (matrix[q, k] - matrix[p, k]) / (2.0 * off if off != 0.0 else 1.0)
        tangent = 1.0 / (abs(ratio) + np.sqrt(ratio * ratio + 1.0))
        tangent = -tangent if ratio < 0.0 else tangent
        tangent = tangent if off != 0.0 else 0.0
        cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
        sine = tangent * cosine
        matrix[p, k] -= tangent * off
        matrix[q, k] += tangent * off
        matrix[pq, k] = 0.0
        along_p, along_q = matrix[rp, k], matrix[rq, k]
        matrix[rp, k] = cosine * along_p - sine * along_q
        matrix[rq, k] = sine * along_p + cosine * along_q
        for a in range(3):
            along_p, along_q = axes[3 * a + p, k], axes[3 * a + q, k]
            axes[3 * a + p, k] = cosine * along_p - sine * along_q
            axes[3 * a + q, k] = sine * along_p + cosine * along_q
