"""One loop more on a component that was solved: held against a whole new optimisation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lab.pose_graphs.one_loop import run
from revisit.core.geometry import se3, se3_rows
from revisit.core.pose_graph.graph import GraphState, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.optimisation import Robustness, optimise
from revisit.core.pose_graph.warm_start import MOST_HELD, SolvedComponent
from tests.support.made_up_fleet import Fleet, fleet, random_motion

LATER = 12


@pytest.fixture(scope="module")
def made() -> Fleet:
    return fleet(11, 0.0)


def solved_without(made: Fleet, last: int) -> SolvedComponent:
    """The fleet solved without its last loops."""
    fewer = PoseGraph.of(list(made.graph.trajectories), list(made.graph.loops[:-last]))
    poses = optimise(fewer, Robustness.PLAIN).T_map_submap
    return SolvedComponent(fewer, poses, range(len(fewer.loops)), fewer.trajectories[0].session)


def farthest_m(solved: SolvedComponent, T_map_submap: dict[str, np.ndarray]) -> float:
    return max(
        float(np.abs(solved.T_map_submap(Node(name, n))[:3, 3] - pose[:3, 3]).max())
        for name, poses in T_map_submap.items()
        for n, pose in enumerate(poses)
    )


def test_loops_one_by_one_give_the_poses_of_a_whole_new_optimisation(made: Fleet) -> None:
    solved = solved_without(made, MOST_HELD + 2)  # more than one factorisation carries
    for loop in made.graph.loops[-MOST_HELD - 2 :]:
        assert solved.add(loop) is GraphState.IN_MAP
    assert solved.carried == 2
    assert farthest_m(solved, optimise(made.graph, Robustness.PLAIN).T_map_submap) < 0.01


def test_a_wrong_loop_is_set_aside_and_moves_nothing(made: Fleet) -> None:
    solved, last = solved_without(made, 1), made.graph.loops[-1]
    before = {node: solved.T_map_submap(node) for node in (last.match, last.query)}
    wrong = replace(last, name="wrong", T_match_query=random_motion(np.random.default_rng(0)))
    assert solved.add(wrong) is GraphState.SET_ASIDE
    assert all(np.array_equal(solved.T_map_submap(node), pose) for node, pose in before.items())
    assert solved.add(last) is GraphState.IN_MAP


def test_submaps_that_came_later_are_moved_by_loops_as_if_they_had_been_there(made: Fleet) -> None:
    session = made.graph.trajectories[-1]
    known = len(session) - LATER
    is_later = [max(end.ordinal for end in (one.match, one.query) if end.session == session.session) >= known
                if session.session in (one.match.session, one.query.session) else False
                for one in made.graph.loops]  # fmt: skip
    early = [one for one, later in zip(made.graph.loops, is_later, strict=True) if not later]
    late = [one for one, later in zip(made.graph.loops, is_later, strict=True) if later]
    assert len(late) >= 2
    cut = Trajectory(session.session, session.T_odom_submap[:known], session.step_covariances[: known - 1])
    fewer = PoseGraph.of([*made.graph.trajectories[:-1], cut], early)
    anchor = fewer.trajectories[0].session
    poses = optimise(fewer, Robustness.PLAIN).T_map_submap
    solved = SolvedComponent(fewer, poses, range(len(early)), anchor)
    for n in range(known - 1, len(session) - 1):
        T_step = se3.inverse(session.T_odom_submap[n]) @ session.T_odom_submap[n + 1]
        assert solved.append(session.session, T_step, session.step_covariances[n]) == Node(session.session, n + 1)
    for loop in late:
        assert solved.add(loop) is GraphState.IN_MAP
    whole = optimise(made.graph, Robustness.PLAIN).T_map_submap
    assert farthest_m(solved, whole) < 0.1
    solved.refresh()
    assert (solved.carried, farthest_m(solved, whole) < 0.02) == (0, True)  # to second order: they move by 0.75 m


def test_many_transforms_at_once_are_each_as_one_by_one() -> None:
    rng = np.random.default_rng(0)
    tangents = rng.normal(size=(200, 6)) * np.repeat(10.0 ** rng.uniform(-9, 0.3, 200), 6).reshape(-1, 6)
    tangents[0] = 0.0
    transforms = np.stack([se3.exp(one) for one in tangents])
    np.testing.assert_allclose(se3_rows.exp(tangents), transforms, atol=1e-12)
    np.testing.assert_allclose(se3_rows.log(transforms), np.stack([se3.log(one) for one in transforms]), atol=1e-9)
    np.testing.assert_allclose(se3_rows.inverse(transforms), np.linalg.inv(transforms), atol=1e-12)
    np.testing.assert_allclose(se3_rows.adjoint(transforms), np.stack([se3.adjoint(one) for one in transforms]))


def test_the_benchmark_of_single_loops_takes_right_ones_to_where_a_whole_optimisation_does() -> None:
    found = run(poses=400, loops=12)
    assert found.taken == len(found.cpu_ms) == 12
    assert found.distance_m < 0.05


def test_a_step_that_the_poses_have_mended_stays_mended(made: Fleet) -> None:
    """Odometry as it came is what later loops find; the map knows better."""
    (session, *others), slip = made.graph.trajectories, se3.from_yaw(0.0, (-6.0, 0.0, 0.0))
    broken = session.T_odom_submap.copy()
    broken[40:] = broken[39] @ slip @ se3.inverse(broken[39]) @ broken[40:]
    graph = PoseGraph.of([replace(session, T_odom_submap=broken), *others], list(made.graph.loops[:-1]))
    poses = optimise(made.graph, Robustness.PLAIN).T_map_submap
    solved = SolvedComponent(graph, poses, range(len(graph.loops)), session.session)
    assert solved.add(made.graph.loops[-1]) is GraphState.IN_MAP
    solved.refresh()
    assert farthest_m(solved, poses) < 0.1
