"""Least squares by Levenberg and Marquardt, and graduated non-convexity around it.

The longest call is one factorisation, so that the heartbeat of a worker goes on beside a map that takes a minute
(docs/decisions/0274).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3_rows
from revisit.core.pose_graph.normal_equations import Equations, Rows

Array64 = NDArray[np.float64]

MAX_STEPS = 100
TOLERANCE = 1e-9
"""Of the cost, relative and absolute."""

ROUGHLY = 1e-4
"""Of the cost, relative, where the result is but a start: Cauchy weights, rounds of graduated non-convexity."""

MAX_SETTLING = 6
SETTLED_STEP = 1e-7
"""Length of a step of all poses together, metres and radians, after which they are where they belong."""

INLIER = 0.5 * 16.81
"""Cost of a loop, half of its squared distance, that 99 % of right ones stay below (chi-square, 6 degrees)."""

_GROWTH, _MAX_ROUNDS, _SETTLED_WEIGHT = 1.4, 100, 1e-4
"""Of graduated non-convexity, as Yang et al. have them."""
_DAMPING, _MOST_DAMPING, _DAMPING_FACTOR = 1e-5, 1e5, 10.0
_LEAST_FIDELITY = 1e-3
"""The share of the predicted saving that a step must reach."""

Kernel = Callable[[Array64], tuple[Array64, Array64]]
"""Costs (e,) and weights (e,) of edges at squared distances (e,)."""


T = TypeVar("T", bound="Terms")


class Terms(Protocol):
    """Measurements of poses (n, 4, 4), e of them, each with an error (6,): edges, or edges and absolute ones."""

    def __len__(self) -> int: ...

    def chosen(self: T, which: NDArray[np.bool_] | Rows) -> T:
        """Some of them."""
        ...

    def weighted(self: T, weights: Array64) -> T:
        """The same with their information times weights (e,)."""
        ...

    def surer(self: T, factors: Array64) -> T:
        """The same with the standard deviations of the first s of them, edges, times `factors` (s, 6)."""
        ...

    def errors(self, poses: Array64) -> Array64:
        """Their errors (e, 6)."""
        ...

    def squared(self, errors: Array64) -> Array64:
        """Squared Mahalanobis distances (e,) of errors (e, 6)."""
        ...

    def squared_errors(self, poses: Array64) -> Array64:
        """Squared Mahalanobis distances (e,) of poses."""
        ...

    def linearised(self, poses: Array64, errors: Array64, weights: Array64) -> Equations:
        """The normal equations at poses with these errors (e, 6) and weights (e,), in tangents of the poses."""
        ...


def squares(squared: Array64) -> tuple[Array64, Array64]:
    """The kernel of plain least squares."""
    return squared, np.ones_like(squared)


def cauchy(squared: Array64) -> tuple[Array64, Array64]:
    """Cauchy's kernel with its scale at a distance of 1: outliers pull little."""
    return np.log1p(squared), 1.0 / (1.0 + squared)


def huber(squared: Array64) -> tuple[Array64, Array64]:
    """Huber's kernel: squares up to a distance of 1.345, then straight."""
    distance, near = np.sqrt(squared), 1.345
    inside = distance <= near
    return (
        np.where(inside, squared, near * (2.0 * distance - near)),
        np.where(inside, 1.0, near / np.maximum(distance, near)),
    )


def minimise(
    edges: Terms, anchor: int | None, start: Array64, tolerance: float = TOLERANCE, kernel: Kernel = squares
) -> Array64:
    """The poses (n, 4, 4) of least cost near `start`, by Levenberg and Marquardt; the one in row `anchor` stays.

    `anchor` is None where terms tie the poses to the world.

    `tolerance` of the cost is relative.
    """
    poses, damping = start, _DAMPING
    errors, cost, weights = _cost(edges, poses, kernel)
    for _ in range(MAX_STEPS):
        equations, before = edges.linearised(poses, errors, weights), cost
        while damping <= _MOST_DAMPING:
            moved, expected = _step(equations, anchor, poses, damping)
            new_errors, new, new_weights = _cost(edges, moved, kernel)
            if before - new > _LEAST_FIDELITY * expected:
                poses, errors, cost, weights = moved, new_errors, new, new_weights
                damping /= _DAMPING_FACTOR
                break
            if abs(before - new) <= TOLERANCE * before:  # nothing is left but rounding
                break
            damping *= _DAMPING_FACTOR
        del equations  # the next ones take as much room
        saved = before - cost
        if not saved > TOLERANCE or saved <= tolerance * before:
            break
    return poses


def settled(edges: Terms, anchor: int | None, poses: Array64) -> Array64:
    """The least cost itself, by Gauss-Newton steps from `poses` near it: where it lies does not depend on the way
    there. `poses` where no step can be computed.
    """
    ones = np.ones(len(edges))
    for _ in range(MAX_SETTLING):
        try:
            step = _solved(edges.linearised(poses, edges.errors(poses), ones), anchor, 0.0)
        except RuntimeError:
            return poses
        poses = poses @ se3_rows.exp(step)
        if np.linalg.norm(step) < SETTLED_STEP:
            break
    return poses


def graduated(edges: Terms, known: int, anchor: int | None, start: Array64) -> Array64:
    """Graduated non-convexity with truncated least squares (Yang et al. 2020): loops end with weight 0 or 1.

    The first `known` edges are steps, which are right; the others are loops. From a convex cost towards the truncated
    one; each round begins where the last one ended, the first one at `start`: poses that wrong loops with full weight
    have bent can be too far from the right ones to come back.
    """
    loops, poses = edges.chosen(np.arange(known, len(edges))), start
    if not len(loops):
        return minimise(edges, anchor, start)
    control = INLIER / max(loops.squared_errors(start).max() - INLIER, INLIER)
    for _ in range(_MAX_ROUNDS):
        weights = _truncated(0.5 * loops.squared_errors(poses), control)
        heard = np.concatenate([np.ones(known), weights])
        poses = minimise(edges.weighted(heard).chosen(heard > 0.0), anchor, poses, ROUGHLY)
        if not ((weights > 0.0) & (weights < 1.0 - _SETTLED_WEIGHT)).any():
            break
        control *= _GROWTH
    return poses


def _cost(edges: Terms, poses: Array64, kernel: Kernel) -> tuple[Array64, float, Array64]:
    """The errors (e, 6) of all edges, half of their total cost, and their weights (e,)."""
    errors = edges.errors(poses)
    costs, weights = kernel(edges.squared(errors))
    return errors, 0.5 * float(costs.sum()), weights


def _step(equations: Equations, anchor: int | None, poses: Array64, damping: float) -> tuple[Array64, float]:
    """The poses after a damped step, and its predicted saving; the same poses where none can be computed."""
    try:
        step = _solved(equations, anchor, damping)
    except RuntimeError:
        return poses, np.inf
    expected = 0.5 * float(damping * np.vdot(step, step) - np.vdot(equations.gradient, step))
    return poses @ se3_rows.exp(step), expected


def _solved(equations: Equations, anchor: int | None, damping: float) -> Array64:
    """The step (n, 6) towards the least cost; the anchor, if any, stays where it is.

    The pull at the anchor counts: all pulls together are none, and a part of them would move the whole map.
    """
    step = equations.factorised(anchor, damping).solve(-equations.gradient)
    if anchor is not None:
        step[anchor] = 0.0
    return step


def _truncated(costs: Array64, control: float) -> Array64:
    """The weights (n,) of loops of these costs: the weighted cost of one outside is flat, the more so the larger
    `control` is.
    """
    weights = np.sqrt(INLIER * control * (control + 1.0) / np.maximum(costs, TOLERANCE)) - control
    return np.asarray(np.clip(weights, 0.0, 1.0))
