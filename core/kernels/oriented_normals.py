"""Normals of surfaces: the direction of least variance of the returns, on the side of the sensor (paper III-B 1)."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop

Array64 = NDArray[np.float64]

NORMAL_PRIOR = 0.05
_SWEEPS = 12
_NEGLIGIBLE = 1e-18  # of what is squared: axes are right within a billionth


def oriented_normals(covariances: Array64, views: Array64) -> NDArray[np.float32]:
    """Unit normals (n, 3) towards the sensor: least variance, with a prior for the viewing direction.

    covariances (n, 3, 3), of any scale; views (n, 3) towards the sensor, of any length. The prior decides where returns
    form a line (one beam on a wall) or a single spot.
    """
    normals = np.empty((len(covariances), 3), dtype=np.float32)
    _orient(covariances, views, np.empty((3, 3)), np.empty((3, 3)), np.empty(3), normals)
    return normals


@loop
def _orient(
    covariances: Array64, views: Array64, matrix: Array64, axes: Array64, view: Array64, normals: NDArray[np.float32]
) -> None:
    """Fill `normals` (n, 3); `matrix`, `axes` (3, 3) and `view` (3,) are for its use."""
    for i in range(len(covariances)):
        spread = covariances[i, 0, 0] + covariances[i, 1, 1] + covariances[i, 2, 2] + 1e-9
        length = np.sqrt(views[i, 0] ** 2 + views[i, 1] ** 2 + views[i, 2] ** 2) + 1e-12
        for a in range(3):
            view[a] = views[i, a] / length
        for a in range(3):
            for b in range(3):
                matrix[a, b] = covariances[i, a, b] / spread - NORMAL_PRIOR * view[a] * view[b]
            matrix[a, a] += NORMAL_PRIOR
        _diagonalise(matrix, axes)
        least = 0
        for a in range(1, 3):
            if matrix[a, a] < matrix[least, least]:
                least = a
        facing = axes[0, least] * view[0] + axes[1, least] * view[1] + axes[2, least] * view[2]
        sign = -1.0 if facing < 0.0 else 1.0
        for a in range(3):
            normals[i, a] = sign * axes[a, least]


@numba.njit(inline="always")
def _diagonalise(matrix: Array64, axes: Array64) -> None:
    """Jacobi's method: the symmetric `matrix` (3, 3) becomes diagonal, the columns of `axes` its eigenvectors."""
    for a in range(3):
        for b in range(3):
            axes[a, b] = 1.0 if a == b else 0.0
    for _ in range(_SWEEPS):
        aside = matrix[0, 1] ** 2 + matrix[0, 2] ** 2 + matrix[1, 2] ** 2
        if aside <= _NEGLIGIBLE * (matrix[0, 0] ** 2 + matrix[1, 1] ** 2 + matrix[2, 2] ** 2):
            break
        for p, q in ((0, 1), (0, 2), (1, 2)):
            if matrix[p, q] != 0.0:
                _rotate(matrix, axes, p, q)


@numba.njit(inline="always")
def _rotate(matrix: Array64, axes: Array64, p: int, q: int) -> None:
    """Turn in the plane of axes p and q so that matrix[p, q] becomes zero."""
    ratio = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
    tangent = 1.0 / (abs(ratio) + np.sqrt(ratio * ratio + 1.0))
    if ratio < 0.0:
        tangent = -tangent
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    r = 3 - p - q
    matrix[p, p] -= tangent * matrix[p, q]
    matrix[q, q] += tangent * matrix[p, q]
    matrix[p, q] = matrix[q, p] = 0.0
    along_p, along_q = matrix[r, p], matrix[r, q]
    matrix[r, p] = matrix[p, r] = cosine * along_p - sine * along_q
    matrix[r, q] = matrix[q, r] = sine * along_p + cosine * along_q
    for a in range(3):
        along_p, along_q = axes[a, p], axes[a, q]
        axes[a, p] = cosine * along_p - sine * along_q
        axes[a, q] = sine * along_p + cosine * along_q
