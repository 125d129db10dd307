"""Normal equations of point-to-plane residuals, summed up several pairs at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inner_sums

Array64 = NDArray[np.float64]

CHUNK = 256
"""Pairs that are collected before they are summed up: as many as stay near the processor."""


@inner_sums
def add_normal_equations(rows: Array64, count: int, hessian: Array64, gradient: Array64) -> None:
    """Adds the first `count` columns of `rows` (9, k) to the lower half of `hessian` (6, 6) and to `gradient` (6,).

    A column is the derivative (6,) of a residual, the residual and its weight; the last row is for use here.
    """
    for a in range(6):
        total = 0.0
        for k in range(count):
            rows[8, k] = rows[7, k] * rows[a, k]
            total += rows[8, k] * rows[6, k]
        gradient[a] += total
        for b in range(a + 1):
            total = 0.0
            for k in range(count):
                total += rows[8, k] * rows[b, k]
            hessian[a, b] += total
