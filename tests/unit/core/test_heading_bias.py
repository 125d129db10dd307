"""Odometry whose heading turns steadily: found where right loops agree on it, and never made up for wrong ones."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.heading_bias import MOST_RAD_PER_M, heading_bias
from revisit.core.pose_graph.optimisation import optimise
from revisit.core.pose_graph.support import loops_within
from tests.support.made_up_fleet import LOOP_COVARIANCE

STEP_M = 5.0
SUBMAPS = 240
BLOCK = 60
"""Submaps of a way around."""


def true_way() -> np.ndarray:
    """Four times around a block of 75 m a side: T_world_submap (n, 4, 4)."""
    side = BLOCK // 4
    turns = [np.pi / 2 if number % side == side - 1 else 0.0 for number in range(SUBMAPS - 1)]
    poses = [np.eye(4)]
    for turn in turns:
        poses.append(poses[-1] @ se3.from_yaw(turn, (STEP_M, 0.0, 0.0)))
    return np.stack(poses)


def turned(poses: np.ndarray, rad_per_m: float, seed: int = 0) -> np.ndarray:
    """What odometry makes of a way whose heading turns by so much too far, with noise of a tenth of a per cent."""
    rng, found = np.random.default_rng(seed), [np.eye(4)]
    for first, second in itertools.pairwise(poses):
        noise = rng.normal(0.0, [0.005, 0.005, 0.005, 5e-4, 5e-4, 5e-4])
        step = se3.inverse(first) @ second @ se3.from_yaw(rad_per_m * STEP_M) @ se3.exp(noise)
        found.append(found[-1] @ step)
    return np.stack(found)


def loop(poses: np.ndarray, match: int, query: int, aside: np.ndarray | None = None) -> LoopEdge:
    """What a loop says that is right, or wrong by `aside`."""
    T_match_query = se3.inverse(poses[match]) @ poses[query]
    measured = T_match_query if aside is None else aside @ T_match_query
    return LoopEdge(f"{match}-{query}", Node("one", match), Node("one", query), measured, LOOP_COVARIANCE)


def right_loops(poses: np.ndarray) -> list[LoopEdge]:
    return [loop(poses, number, number + BLOCK) for number in range(0, SUBMAPS - BLOCK, 2)]


@pytest.mark.parametrize("degrees_per_m", [-0.15, 0.08, 0.25])
def test_a_heading_that_turns_steadily_costs_no_loop_and_no_metre(degrees_per_m: float) -> None:
    poses = true_way()
    bias = np.radians(degrees_per_m)
    odometry = Trajectory.from_odometry("one", turned(poses, bias))
    graph = PoseGraph.of([odometry], right_loops(poses))
    assert heading_bias(*of(graph)) == pytest.approx(bias, rel=0.02)
    answer = optimise(graph)
    assert set(answer.loops) == {GraphState.IN_MAP}
    apart = np.linalg.norm(answer.T_map_submap["one"][:, :3, 3] - poses[:, :3, 3], axis=1)
    assert apart.max() < 0.02 * np.linalg.norm(odometry.T_odom_submap[:, :3, 3] - poses[:, :3, 3], axis=1).max()


def of(graph: PoseGraph) -> tuple[Trajectory, list[LoopEdge]]:
    return graph.trajectories[0], loops_within(graph, graph.trajectories[0])[1]


WRONG = {
    "a street beside it": se3.from_yaw(0.0, (0.0, 40.0, 0.0)),
    "a street farther on": se3.from_yaw(0.0, (60.0, 0.0, 0.0)),
    "a corner that looks alike": se3.from_yaw(np.pi / 2, (15.0, 30.0, 0.0)),
    "the other end of a hall": se3.from_yaw(np.pi, (30.0, 5.0, 0.0)),
    "ten storeys above it": se3.from_yaw(0.0, (0.0, 0.0, 30.0)),
}


@pytest.mark.parametrize("place", WRONG)
def test_wrong_loops_that_agree_are_no_bias(place: str) -> None:
    poses = true_way()
    wrong = [loop(poses, number, number + BLOCK, WRONG[place]) for number in range(0, SUBMAPS - BLOCK, 2)]
    graph = PoseGraph.of([Trajectory.from_odometry("one", turned(poses, 0.0))], wrong)
    assert heading_bias(*of(graph)) == 0.0
    assert GraphState.IN_MAP not in optimise(graph).loops


def test_wrong_loops_among_right_ones_are_no_bias_and_do_not_hide_one() -> None:
    poses, rng = true_way(), np.random.default_rng(3)
    ends = [tuple(sorted(rng.choice(SUBMAPS, 2, replace=False))) for _ in range(60)]
    wrong = [loop(poses, int(a), int(b), se3.from_yaw(rng.uniform(-3, 3), (20.0, 9.0, 0.0))) for a, b in ends]
    wrong = [one for number, one in enumerate(wrong) if one.name not in {other.name for other in wrong[:number]}]
    for bias in (0.0, np.radians(0.1)):
        graph = PoseGraph.of([Trajectory.from_odometry("one", turned(poses, bias))], right_loops(poses) + wrong)
        assert heading_bias(*of(graph)) == pytest.approx(bias, abs=2e-5)
        states = dict(zip((one.name for one in graph.loops), optimise(graph).loops, strict=True))
        assert all(states[one.name] is GraphState.IN_MAP for one in right_loops(poses))
        assert not any(states[one.name] is GraphState.IN_MAP for one in wrong)


def test_a_stretch_taken_for_another_has_one_vote_against_a_bias() -> None:
    """Eighteen neighbours that agree are one mistake: right loops all over the way know better."""
    poses, bias = true_way(), np.radians(0.1)
    odometry, right = Trajectory.from_odometry("one", turned(poses, bias)), right_loops(poses)[::2]
    wrong = a_stretch_for_another(odometry, 21, 98, 18)
    graph = PoseGraph.of([odometry], right + wrong)
    assert heading_bias(*of(graph)) == pytest.approx(bias, abs=2e-5)
    states = dict(zip((one.name for one in graph.loops), optimise(graph).loops, strict=True))
    assert all(states[one.name] is GraphState.IN_MAP for one in right)
    assert not any(states[one.name] is GraphState.IN_MAP for one in wrong)


def a_stretch_for_another(odometry: Trajectory, match: int, query: int, count: int) -> list[LoopEdge]:
    """Wrong loops between two stretches of so many submaps that agree with each other as well as the odometry does."""
    placed = np.linalg.inv(odometry.T_odom_submap) @ odometry.T_odom_submap[match] @ WRONG["a street beside it"]
    moved = se3.inverse(odometry.T_odom_submap[query]) @ odometry.T_odom_submap
    return [
        LoopEdge(f"{a}-{b}", Node("one", a), Node("one", b), placed[a] @ moved[b], LOOP_COVARIANCE)
        for a, b in zip(range(match, match + count), range(query, query + count), strict=True)
    ]


def test_a_bias_beyond_the_most_and_few_loops_are_left_alone() -> None:
    poses = true_way()
    beyond = Trajectory.from_odometry("one", turned(poses, 1.5 * MOST_RAD_PER_M))
    assert heading_bias(*of(PoseGraph.of([beyond], right_loops(poses)))) == 0.0
    odometry = Trajectory.from_odometry("one", turned(poses, np.radians(0.15)))
    assert heading_bias(*of(PoseGraph.of([odometry], right_loops(poses)[:5]))) == 0.0
    assert heading_bias(odometry, []) == 0.0
