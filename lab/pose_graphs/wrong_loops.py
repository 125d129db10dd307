"""Wrong loops put into a pose graph on purpose: random ones, and aliases that agree with each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import LoopEdge, Node, PoseGraph, Trajectory

WRONG = "wrong-"
"""How the names of wrong loops begin."""

LEAST_SPAN = 50
"""Submaps between the ends of a wrong loop."""

ALIAS_LENGTH = 20
"""Successive loops that agree with each other: a street taken for another one over so many submaps."""

REACH_M = 5.0
"""How far apart a wrong loop puts its ends, along each axis at most."""

REGISTRATION_SIGMAS = 0.02, 0.002
"""Standard deviations of a registration's error: metres and radians."""


def with_random_loops(graph: PoseGraph, share: float, seed: int) -> PoseGraph:
    """The graph of one session with wrong loops between random submaps, so many that they are `share` of all loops."""
    rng, (trajectory,) = np.random.default_rng(seed), graph.trajectories
    wrong = []
    for number in range(_wrong_count(graph, share)):
        first, second = _ends(len(trajectory), 1, rng)
        wrong.append(_loop(graph, number, first, second, _random_motion(graph, rng), rng))
    return PoseGraph.of([trajectory], [*graph.loops, *wrong])


def with_agreeing_loops(graph: PoseGraph, share: float, seed: int) -> PoseGraph:
    """The same with aliases: runs of ALIAS_LENGTH loops that place one stretch on another, wrongly but alike.

    Within a run the loops agree as far as the odometry does, up to the noise of a registration.
    """
    return with_aliases(graph, _wrong_count(graph, share), seed)


def with_aliases(graph: PoseGraph, count: int, seed: int, length: int = ALIAS_LENGTH) -> PoseGraph:
    """The same with so many wrong loops, in runs of `length`."""
    rng, (trajectory,) = np.random.default_rng(seed), graph.trajectories
    wrong: list[LoopEdge] = []
    while len(wrong) < count:
        first, second = _ends(len(trajectory), length, rng)
        T_first_second = _random_motion(graph, rng)
        for step in range(min(length, count - len(wrong))):
            moved = se3.inverse(_motion(trajectory, first, step)) @ T_first_second @ _motion(trajectory, second, step)
            moved = moved @ _noise(graph, rng)
            wrong.append(_loop(graph, len(wrong), first + step, second + step, moved, rng))
    return PoseGraph.of([trajectory], [*graph.loops, *wrong])


def is_wrong(loop: LoopEdge) -> bool:
    """Whether this module made the loop."""
    return loop.name.startswith(WRONG)


def _wrong_count(graph: PoseGraph, share: float) -> int:
    return round(len(graph.loops) * share / (1.0 - share))


def _ends(submaps: int, length: int, rng: np.random.Generator) -> tuple[int, int]:
    """The first submaps of two stretches of `length`, which lie LEAST_SPAN submaps apart."""
    first = int(rng.integers(0, submaps - 2 * length - LEAST_SPAN))
    return first, int(rng.integers(first + length + LEAST_SPAN, submaps - length + 1))


def _random_motion(graph: PoseGraph, rng: np.random.Generator) -> se3.Matrix4:
    """Up to REACH_M along each axis and any turn, within the plane where the graph is planar."""
    if _planar(graph):
        return se3.from_yaw(rng.uniform(-np.pi, np.pi), (*rng.uniform(-REACH_M, REACH_M, 2), 0.0))
    return se3.from_quaternion(_unit(rng.normal(size=4)), rng.uniform(-REACH_M, REACH_M, 3))


def _noise(graph: PoseGraph, rng: np.random.Generator) -> se3.Matrix4:
    """The error of a registration, within the plane where the graph is planar."""
    tangent = rng.normal(size=6) * np.repeat(REGISTRATION_SIGMAS, 3)
    return se3.exp(tangent * [1, 1, 0, 0, 0, 1] if _planar(graph) else tangent)


def _planar(graph: PoseGraph) -> bool:
    return all(not one.T_odom_submap[:, 2, 3].any() for one in graph.trajectories)


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vector / np.linalg.norm(vector))


def _motion(trajectory: Trajectory, first: int, steps: int) -> se3.Matrix4:
    """From submap `first` to the one so many steps later."""
    poses = trajectory.T_odom_submap
    return np.asarray(se3.inverse(poses[first]) @ poses[first + steps])


def _loop(graph: PoseGraph, number: int, first: int, second: int, T: se3.Matrix4, rng: np.random.Generator) -> LoopEdge:
    """A wrong loop that looks like a recorded one: it states that one's uncertainty."""
    like = graph.loops[int(rng.integers(len(graph.loops)))]
    session = graph.trajectories[0].session
    turn = se3.adjoint(T)
    covariance = turn @ like.covariance_in_query @ turn.T
    ends = Node(session, first), Node(session, second)
    return LoopEdge(f"{WRONG}{number}", *ends, T, covariance, like.independent_share)
