"""Odometry whose heading turns steadily: by how much, where the loops of a session agree on it.

A gyro that is off by 0.05 degrees a second turns a way of 100 m by 10 degrees at walking speed. Submaps and loops are
as good as ever, but the drift of the odometry is no random one: held against that, most right loops are refuted.
One number explains all of them then, and no wrong ones: a place taken for another one lies elsewhere by more than a
turn (docs/decisions/0095).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.path import travelled_m
from revisit.core.pose_graph.consistency import MAX_CLOSING_ERROR, Circles
from revisit.core.pose_graph.graph import LoopEdge, PoseGraph, Trajectory
from revisit.core.pose_graph.support import have_support, loops_within, odometry_errors, places, votes

Array64 = NDArray[np.float64]

LEAST_LOOPS = 10
"""Loops with support that a session must have."""

ASKED_OF = 2000
"""Loops of a session, at most, that are asked."""

REFUTED, EXPLAINED = 0.2, 0.8
"""The share of loops with support that odometry refutes, from which on a bias is sought, and that it must explain.

A place counts once, however many loops show it (see `places`).
"""

MOST_RAD_PER_M, STEP_RAD_PER_M = float(np.radians(0.3)), float(np.radians(5e-4))
_NEAR = 3.0
"""Standard deviations within which a loop agrees with a bias."""


def straightened(graph: PoseGraph) -> PoseGraph:
    """The graph with the odometry of each session turned back by its bias, where there is one."""
    tracks = [_without(one, heading_bias(one, loops_within(graph, one)[1])) for one in graph.trajectories]
    return replace(graph, trajectories=tuple(tracks))


def heading_bias(trajectory: Trajectory, loops: list[LoopEdge]) -> float:
    """By how much the heading of a session turns too far, radians a metre travelled; 0 unless that is beyond doubt.

    `loops` are those within the session, each with the earlier submap as its match.
    """
    loops = loops[:: -(-len(loops) // ASKED_OF) or 1]
    if len(loops) < LEAST_LOOPS:
        return 0.0
    circles = Circles.of(loops, trajectory, trajectory)
    fits = odometry_errors(circles) < MAX_CLOSING_ERROR
    if fits.all():
        return 0.0
    borne = np.flatnonzero(have_support(circles, np.arange(len(loops))))
    if len(borne) < LEAST_LOOPS:
        return 0.0
    counts = votes(places(circles, borne))
    if np.average(fits[borne], weights=counts) >= 1.0 - REFUTED:
        return 0.0
    bias = _most_agreed(circles, borne, counts)
    turned = _without(trajectory, bias)
    explained = odometry_errors(Circles.of([loops[row] for row in borne], turned, turned)) < MAX_CLOSING_ERROR
    return bias if np.average(explained, weights=counts) >= EXPLAINED else 0.0


def _most_agreed(circles: Circles, rows: NDArray[np.int64], counts: Array64) -> float:
    """The bias with which most votes of the loops `rows` (n,) agree, radians a metre; the smaller of two.

    Each loop counts `counts` (n,).
    """
    first, second = circles.ends[rows].T
    way_m = travelled_m(circles.second.T_odom_submap[:, :3, 3])
    apart_m = way_m[second] - way_m[first]
    turn = circles.T_first_second[rows]
    turned = np.arctan2(turn[:, 0, 1] - turn[:, 1, 0], turn[:, 0, 0] + turn[:, 1, 1])
    near = _NEAR * np.sqrt(circles.variances[rows, 1] + circles.second.drift(first, second)[1])
    biases = np.arange(-MOST_RAD_PER_M, MOST_RAD_PER_M, STEP_RAD_PER_M)
    biases = biases[np.argsort(np.abs(biases), kind="stable")]
    agreed = [float(counts[np.abs(_wrapped(turned - bias * apart_m)) < near].sum()) for bias in biases]
    bias = float(biases[int(np.argmax(np.round(agreed, 9)))])
    left = _wrapped(turned - bias * apart_m)
    weights = counts * (np.abs(left) < near) / near**2
    return bias + float((weights * apart_m * left).sum() / max((weights * apart_m**2).sum(), 1e-12))


def _without(trajectory: Trajectory, bias: float) -> Trajectory:
    """The trajectory with its heading turned back by `bias` radians for each metre travelled."""
    if bias == 0.0:
        return trajectory
    poses = trajectory.T_odom_submap.copy()
    angles = -bias * travelled_m(poses[:, :3, 3])
    steps = _turns(0.5 * (angles[1:] + angles[:-1])) @ np.diff(poses[:, :3, 3], axis=0)[..., None]
    poses[1:, :3, 3] = poses[0, :3, 3] + np.cumsum(steps[..., 0], axis=0)
    poses[:, :3, :3] = _turns(angles) @ poses[:, :3, :3]
    return replace(trajectory, T_odom_submap=poses)


def _turns(angles: Array64) -> Array64:
    """Rotations (n, 3, 3) about z."""
    turns = np.zeros((len(angles), 3, 3))
    turns[:, 0, 0], turns[:, 0, 1] = np.cos(angles), -np.sin(angles)
    turns[:, 1, 0], turns[:, 1, 1], turns[:, 2, 2] = np.sin(angles), np.cos(angles), 1.0
    return turns


def _wrapped(angles: Array64) -> Array64:
    """Angles (n,) from -pi to pi."""
    return np.asarray((angles + np.pi) % (2.0 * np.pi) - np.pi)
