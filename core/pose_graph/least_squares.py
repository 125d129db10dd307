"""Least squares by Levenberg and Marquardt, and graduated non-convexity around it, in short calls of gtsam.

A call of gtsam holds the interpreter's lock from its beginning to its end. Each step is a call of its own, so that the
heartbeat of a worker goes on beside a map that takes a minute (docs/decisions/0099).
"""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
from numpy.typing import NDArray

Array64 = NDArray[np.float64]

MAX_STEPS = 100
TOLERANCE = 1e-9
"""Of the cost, relative and absolute."""

ROUGHLY = 1e-4
"""Of the cost, relative, of what is a start for the next: Cauchy weights, rounds of graduated non-convexity."""

INLIER = 0.5 * 16.81
"""Cost of a loop, half of its squared distance, that 99 % of right ones stay below (chi-square, 6 degrees)."""

_GROWTH, _MAX_ROUNDS, _SETTLED_WEIGHT = 1.4, 100, 1e-4
"""As gtsam's optimiser of graduated non-convexity has them."""

Weighted = Callable[[Array64], gtsam.NonlinearFactorGraph]
"""The factors of a graph whose loops have the weights (n,), 0 to 1."""


def minimise(factors: gtsam.NonlinearFactorGraph, start: gtsam.Values, tolerance: float = TOLERANCE) -> gtsam.Values:
    """The values of least cost near `start`, by Levenberg and Marquardt; `tolerance` of the cost is relative."""
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(MAX_STEPS)
    optimiser = gtsam.LevenbergMarquardtOptimizer(factors, start, params)
    for _ in range(MAX_STEPS):
        before = optimiser.error()
        optimiser.iterate()
        saved = before - optimiser.error()
        if not saved > TOLERANCE or saved <= tolerance * before:
            break
    return optimiser.values()


def graduated(weighted: Weighted, costs: Callable[[gtsam.Values], Array64], start: gtsam.Values) -> gtsam.Values:
    """Graduated non-convexity with truncated least squares (Yang et al. 2020): loops end with weight 0 or 1.

    `costs` are half the squared distances (n,) of the loops. From a convex cost towards the truncated one; each round
    begins where the last one ended, the first one at `start`: poses that wrong loops with full weight have bent can
    be too far from the right ones to come back.
    """
    values, found = start, costs(start)
    if not len(found):
        return minimise(weighted(found), start)
    control = INLIER / max(2.0 * found.max() - INLIER, INLIER)
    for _ in range(_MAX_ROUNDS):
        weights = _truncated(costs(values), control)
        values = minimise(weighted(weights), values, ROUGHLY)
        if not ((weights > 0.0) & (weights < 1.0 - _SETTLED_WEIGHT)).any():
            break
        control *= _GROWTH
    return values


def _truncated(costs: Array64, control: float) -> Array64:
    """The weights (n,) of loops of these costs: the weighted cost of one outside is flat, the more so the larger
    `control` is.
    """
    weights = np.sqrt(INLIER * control * (control + 1.0) / np.maximum(costs, TOLERANCE)) - control
    return np.asarray(np.clip(weights, 0.0, 1.0))
