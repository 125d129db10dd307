"""Steps that loops in the map confirm, and loops that no broken step explains."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pose_graph import broken_steps
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.normal_equations import Edges
from revisit.core.pose_graph.optimisation import optimise
from revisit.core.pose_graph.unconfirmed import Kept, bridges

LOOP_COVARIANCE = np.diag([0.05**2] * 3 + [0.003**2] * 3)
CHAIN = [(n, n + 1) for n in range(9)]


@pytest.mark.parametrize(
    ("loops", "expected"),
    [
        ([], range(9)),
        ([(2, 6)], [0, 1, 6, 7, 8]),
        ([(0, 4), (3, 9)], []),
        ([(4, 5)], [0, 1, 2, 3, 5, 6, 7, 8]),
    ],
    ids=["no loop", "one loop", "loops over all of it", "a loop beside a step"],
)
def test_a_bridge_is_an_edge_on_no_circle(loops, expected):
    found = bridges(np.array([*CHAIN, *loops]), 10)
    assert np.flatnonzero(found).tolist() == list(expected)


def test_bridges_are_those_without_which_a_graph_falls_apart():
    """By the definition, on random graphs, parts and edges beside each other among them."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        ends = np.array([pair for pair in rng.integers(0, 12, (14, 2)).tolist() if pair[0] != pair[1]])
        whole = len(parts(ends))
        expected = [len(parts(np.delete(ends, row, axis=0))) > whole for row in range(len(ends))]
        assert bridges(ends, 12).tolist() == expected


def parts(ends) -> set[frozenset[int]]:
    found = {frozenset((n,)) for n in range(12)}
    for one, other in ends.tolist():
        joined = {part for part in found if part & {one, other}}
        found = found - joined | {frozenset().union(*joined)}
    return found


def laps() -> np.ndarray:
    """T_world_submap (n, 4, 4) of two laps of 40 submaps."""
    step = se3.from_yaw(np.radians(9.0), (4.0, 0.0, 0.0))
    return np.stack(list(itertools.accumulate([step] * 79, np.matmul, initial=np.eye(4))))


def loop(name: str, match: int, query: int, T_match_query: np.ndarray) -> LoopEdge:
    return LoopEdge(name, Node("a", match), Node("a", query), T_match_query, LOOP_COVARIANCE)


def test_a_place_taken_for_another_one_on_a_road_with_loops_is_explained_by_no_step():
    poses = laps()
    right = [loop(f"{n}", n, n + 40, np.eye(4)) for n in range(40)]
    wrong = [loop(f"w{n}", n, n + 20, np.eye(4)) for n in range(5, 15)]
    track = Trajectory.from_odometry("a", poses)
    rows = {Node("a", n): n for n in range(80)}
    kept = Kept(Edges.of_steps([track], rows), Edges.of_loops(right, rows), poses)
    assert not kept.unconfirmed().any()
    assert not kept.may_hold(Edges.of_loops(wrong, rows)).any()
    assert kept.may_hold(Edges.of_loops(right, rows)).all()


def test_steps_that_share_a_fault_from_one_loop_to_the_next_are_unconfirmed_however_little_each_is_bent():
    """Loops of 18 submaps are set aside, along which odometry is 0.75 m too long: each step errs as it states."""
    poses, silent = laps(), range(11, 29)
    longer = [se3.from_yaw(0.0, (0.042, 0.0, 0.0)) if n in silent else np.eye(4) for n in range(79)]
    motions = [se3.inverse(one) @ other @ more for one, other, more in zip(poses, poses[1:], longer, strict=False)]
    track = Trajectory.from_odometry("a", np.stack(list(itertools.accumulate(motions, np.matmul, initial=poses[0]))))
    heard = [loop(f"{n}", n, n + 40, np.eye(4)) for n in range(40) if n not in silent]
    rows = {Node("a", n): n for n in range(80)}
    kept = Kept(Edges.of_steps([track], rows), Edges.of_loops(heard, rows), poses)
    assert kept.bends()[0].max() < 6.0
    assert np.flatnonzero(kept.unconfirmed()).tolist() == list(range(39))


def test_nothing_is_sought_where_most_places_would_stay_wrong_whatever_is_broken(monkeypatch):
    """Aliases of a street that a robot drives again and again: thousands of them made a search without an end."""

    def sought(*_):
        raise AssertionError("a search that can find nothing")

    monkeypatch.setattr(broken_steps, "graduated", sought)
    poses = laps()
    right = [loop(f"{n}", n, n + 40, np.eye(4)) for n in range(40)]
    wrong = [
        loop(f"w{n}-{apart}", n, n + apart, se3.from_yaw(0.2, (1.0, 0.1 * apart, 0.0)))
        for apart in (12, 17, 22, 27, 32)
        for n in range(10, 25)
    ]
    answer = optimise(graph := PoseGraph.of([Trajectory.from_odometry("a", poses)], [*right, *wrong]))
    kept = {one.name for one, state in zip(graph.loops, answer.loops, strict=True) if state is GraphState.IN_MAP}
    assert kept == {one.name for one in right}
    assert answer.faults == ()
