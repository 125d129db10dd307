"""Odometry that goes wrong beyond its model: mended and named where loops show it, never made up for wrong loops."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pose_graph import optimisation
from revisit.core.pose_graph.broken_steps import is_bent
from revisit.core.pose_graph.faults import FaultKind, OdometryFault, torn
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.optimisation import OptimisedGraph, optimise
from tests.support.made_up_fleet import LOOP_COVARIANCE, fleet

STEP_M = 5.0
SUBMAPS = 80
AT = 40
"""The submap that a fault ends at."""

Motion = Callable[[int, np.ndarray], np.ndarray]
"""What odometry makes of the true motion to a submap."""


def winding_way(submaps: int = SUBMAPS) -> np.ndarray:
    """T_world_submap (n, 4, 4) along a road with bends."""
    poses = [np.eye(4)]
    for number in range(submaps - 1):
        poses.append(poses[-1] @ se3.from_yaw(0.06 * np.sin(number / 9.0), (STEP_M, 0.0, 0.0)))
    return np.stack(poses)


def odometry(session: str, poses: np.ndarray, seed: int, wrong: Motion = lambda _, motion: motion) -> Trajectory:
    """A drive along `poses` whose odometry errs a little, and as `wrong` says."""
    rng, found = np.random.default_rng(seed), [se3.from_yaw(0.3 * seed, (10.0 * seed, 3.0, 0.0))]
    for number, (first, second) in enumerate(itertools.pairwise(poses), 1):
        noise = rng.normal(0.0, [0.02, 0.02, 0.02, 1e-3, 1e-3, 1e-3])
        found.append(found[-1] @ wrong(number, se3.inverse(first) @ second) @ se3.exp(noise))
    return Trajectory.from_odometry(session, np.stack(found))


def loops(poses: np.ndarray, seed: int = 7, first: str = "a", second: str = "b") -> list[LoopEdge]:
    """A right loop at every submap between two drives along the same poses."""
    rng = np.random.default_rng(seed)
    noise = [se3.exp(rng.normal(size=6) * np.sqrt(np.diag(LOOP_COVARIANCE))) for _ in poses]
    return [
        LoopEdge(f"{first}{second}-{k:03d}", Node(first, k), Node(second, k), noise[k], LOOP_COVARIANCE)
        for k in range(len(poses))
    ]


def apart_m(answer: OptimisedGraph, first: str = "a", second: str = "b") -> float:
    """How far a drive lies beside the other one in the worst case; they took the same way."""
    gaps = np.linalg.inv(answer.T_map_submap[first]) @ answer.T_map_submap[second]
    return float(np.linalg.norm(gaps[:, :3, 3], axis=1).max())


def at_once(change: np.ndarray) -> Motion:
    return lambda number, motion: motion @ change if number == AT else motion


def scaled(factor: float) -> Motion:
    return lambda _, motion: se3.from_rotation_translation(motion[:3, :3], factor * motion[:3, 3])


def climbing(rise: float) -> Motion:
    return lambda _, motion: motion @ se3.from_rotation_translation(np.eye(3), np.array([0.0, 0.0, rise * STEP_M]))


FAULTS = {
    "a slip of 2 m": (FaultKind.SLIP, 2.0, at_once(se3.from_yaw(0.0, (-2.0, 0.0, 0.0)))),
    "a slip of 5 m": (FaultKind.SLIP, 5.0, at_once(se3.from_yaw(0.0, (-5.0, 0.0, 0.0)))),
    "a slip of 5 m with a tilt of 2.3 degrees": (
        FaultKind.SLIP, 5.0, at_once(se3.exp([-5, 0, 0, 0, np.radians(2.3), 0]))
    ),
    "a slip of 5 m with a turn of 2.3 degrees": (
        FaultKind.SLIP, 5.0, at_once(se3.exp([-5, 0, 0, 0, 0, np.radians(2.3)]))
    ),
    "a jump of 10 m": (FaultKind.JUMP, 10.4, at_once(se3.from_yaw(0.0, (3.0, 10.0, 0.0)))),
    "a turn of 20 degrees": (FaultKind.TURN, np.radians(20.0), at_once(se3.from_yaw(np.radians(20.0)))),
    "a tilt of 6 degrees": (FaultKind.TILT, np.radians(6.0), at_once(se3.exp([0, 0, 0, 0, np.radians(6.0), 0]))),
    "a scale of 5 %": (FaultKind.SCALE, -0.048, scaled(1.05)),
    "a scale of 8 %": (FaultKind.SCALE, -0.074, scaled(1.08)),
    "a slope of 5 %": (FaultKind.SLOPE, -0.05, climbing(0.05)),
    "a heading of 0.1 degrees a metre": (
        FaultKind.HEADING, -np.radians(0.1), lambda _, motion: motion @ se3.from_yaw(np.radians(0.1) * STEP_M)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_odometry_is_named_and_costs_no_loop_and_no_metre(name: str) -> None:
    kind, amount, wrong = FAULTS[name]
    poses = winding_way()
    graph = PoseGraph.of([odometry("a", poses, 1), odometry("b", poses, 2, wrong)], loops(poses))
    answer = optimise(graph)
    assert set(answer.loops) == {GraphState.IN_MAP}
    assert apart_m(answer) < 0.2
    assert answer.chi2 < answer.degrees_of_freedom
    (fault,) = answer.faults
    assert (fault.session, fault.kind) == ("b", kind)
    assert fault.amount == pytest.approx(amount, rel=0.1, abs=0.15 if abs(amount) > 1 else 0.005)
    steady = kind in (FaultKind.SCALE, FaultKind.SLOPE, FaultKind.HEADING)
    assert (fault.first, fault.last) == ((0, SUBMAPS - 1) if steady else (AT - 1, AT))


def test_a_slip_that_many_steps_share_among_them_is_found_between_drives_of_lengths_that_differ() -> None:
    """By 2 %, less than a fault: loops of 15 submaps are set aside, along which each step errs as it states."""
    poses = winding_way(60)

    def slipping(number: int, motion: np.ndarray) -> np.ndarray:
        return scaled(1.01)(number, motion) @ se3.from_yaw(0.0, (-5.0 if number == 30 else 0.0, 0.0, 0.0))

    drives = [odometry("a", poses, 1, scaled(0.99)), odometry("b", poses, 2, slipping)]
    answer = optimise(PoseGraph.of(drives, loops(poses, 0)))
    (fault,) = answer.faults
    assert (fault.session, fault.kind, fault.first, fault.last) == ("b", FaultKind.SLIP, 29, 30)
    assert set(answer.loops) == {GraphState.IN_MAP}
    assert apart_m(answer) < 0.2


def test_two_faults_of_one_drive_are_both_told() -> None:
    poses = winding_way(60)
    changes = {20: se3.from_yaw(0.0, (-4.0, 0.0, 0.0)), 40: se3.from_yaw(np.radians(15.0))}
    wrong = odometry("b", poses, 2, lambda number, motion: motion @ changes.get(number, np.eye(4)))
    answer = optimise(PoseGraph.of([odometry("a", poses, 1), wrong], loops(poses)))
    told = {(one.session, one.kind, one.first, one.last, one.undecided) for one in answer.faults}
    assert told == {("b", FaultKind.SLIP, 19, 20, True), ("b", FaultKind.TURN, 39, 40, True)}
    assert answer.otherwise is not None and apart_m(answer.otherwise) < 0.2


@pytest.mark.parametrize(("back_at", "undecided"), [(53, False), (45, True)])
def test_a_turn_and_a_turn_back_are_two_faults_of_the_drive_whose_steps_are_odd(back_at: int, undecided: bool) -> None:
    """What lies beyond both is aside of where odometry has it. Between turns 10 submaps apart loops are of one place:
    the other drive, whose steps are even, is not blamed for one of them.
    """
    poses = winding_way()
    changes = {2 * AT - back_at: se3.from_yaw(np.radians(12.0)), back_at: se3.from_yaw(np.radians(-12.0))}
    wrong = odometry("b", poses, 2, lambda number, motion: motion @ changes.get(number, np.eye(4)))
    answer = optimise(PoseGraph.of([odometry("a", poses, 1), wrong], loops(poses)))
    told = [(one.session, one.kind, one.last, one.undecided) for one in answer.faults]
    assert told == [("b", FaultKind.TURN, at, undecided) for at in changes]
    mended = answer.otherwise if undecided else answer
    assert mended is not None and apart_m(mended) < 0.2


@pytest.mark.parametrize(
    "name", ["a turn of 20 degrees", "a tilt of 6 degrees", "a slope of 5 %", "a heading of 0.1 degrees a metre"]
)
def test_faults_are_those_about_the_vertical_however_the_sensor_is_mounted(name: str) -> None:
    """Here it lies on its side; the poses are its own."""
    kind, amount, wrong = FAULTS[name]
    poses, T_body_sensor = winding_way(), se3.exp([0.0, 0.0, 0.0, np.pi / 2.0, 0.0, 0.0])
    drives = odometry("a", poses, 1), odometry("b", poses, 2, wrong)
    tracks = [Trajectory.from_odometry(one.session, one.T_odom_submap @ T_body_sensor) for one in drives]
    turned = [
        replace(one, T_match_query=se3.inverse(T_body_sensor) @ one.T_match_query @ T_body_sensor)
        for one in loops(poses)
    ]
    answer = optimise(PoseGraph.of(tracks, turned))
    (fault,) = answer.faults
    assert (fault.session, fault.kind) == ("b", kind)
    assert fault.amount == pytest.approx(amount, rel=0.1)
    assert apart_m(answer) < 0.2


def test_submaps_that_a_turn_tears_are_as_unsure_as_it_shifts_half_of_them() -> None:
    poses = winding_way()
    given = odometry("b", poses, 2, at_once(se3.from_yaw(np.radians(20.0))))
    fault = OdometryFault("b", FaultKind.TURN, AT - 1, AT, float(np.radians(20.0)), 0.01, 9)
    sigma_m = np.sqrt(torn(given, odometry("b", poses, 2).T_odom_submap, [fault], 10.0)[:, :2, :2].trace(0, 1, 2) / 2.0)
    assert sigma_m[[AT - 1, AT]] == pytest.approx(2.5 * np.radians(20.0), rel=0.05)
    assert not sigma_m[: AT - 2].any() and not sigma_m[AT + 2 :].any()


def test_good_odometry_has_no_fault() -> None:
    poses = winding_way()
    graph = PoseGraph.of([odometry("a", poses, 1), odometry("b", poses, 2)], loops(poses))
    assert optimise(graph).faults == ()


def test_what_most_sessions_agree_on_is_believed_even_where_the_faulty_one_gives_the_frame() -> None:
    poses = winding_way()
    tracks = [odometry("a", poses, 1, scaled(1.06)), odometry("b", poses, 2), odometry("c", poses, 3)]
    between = [*loops(poses), *loops(poses, 8, "b", "c"), *loops(poses, 9, "a", "c")]
    answer = optimise(PoseGraph.of(tracks, between))
    assert set(answer.loops) == {GraphState.IN_MAP}
    assert [(one.session, one.kind) for one in answer.faults] == [("a", FaultKind.SCALE)]
    travelled = np.linalg.norm(np.diff(answer.T_map_submap["a"][:, :3, 3], axis=0), axis=1).sum()
    assert travelled == pytest.approx(STEP_M * (SUBMAPS - 1), rel=0.01)


def test_where_no_loop_tells_the_whole_stretch_is_unsure() -> None:
    """A slip of 10 m where no loop is, with steps like one another: which of both slipped is not to be told either."""
    poses = winding_way()
    silent = range(AT - 2, AT + 2)
    slipping = odometry("b", poses, 2, lambda number, motion: scaled(0.5)(0, motion) if number in silent else motion)
    right = [one for one in loops(poses) if one.match.ordinal not in silent]
    answer = optimise(PoseGraph.of([odometry("a", poses, 1), slipping], right))
    assert set(answer.loops) == {GraphState.IN_MAP}
    (fault,) = answer.faults
    assert fault.first < AT - 1 and fault.last > AT
    inside = np.sqrt(answer.covariances[fault.session][AT, :3, :3].trace())
    assert apart_m(answer) < 3.0 * inside


def test_a_turn_somewhere_on_a_way_without_loops_is_a_turn() -> None:
    """Its end is 7 m aside then, which no jump has done."""
    poses, silent = winding_way(), range(AT - 2, AT + 3)
    turning = odometry("b", poses, 2, FAULTS["a turn of 20 degrees"][2])
    right = [one for one in loops(poses) if one.match.ordinal not in silent]
    (fault,) = optimise(PoseGraph.of([odometry("a", poses, 1), turning], right)).faults
    assert (fault.kind, fault.session) == (FaultKind.TURN, "b")
    assert fault.amount == pytest.approx(np.radians(20.0), rel=0.1)


def test_a_slip_that_bends_the_steps_beside_it_and_costs_no_loop_is_found() -> None:
    """Without loops for 20 m the steps between take 2 m among them, each far more than it states."""
    poses, silent = winding_way(), range(AT - 2, AT + 2)
    slipping = odometry("b", poses, 2, FAULTS["a slip of 2 m"][2])
    right = [one for one in loops(poses) if one.match.ordinal not in silent]
    answer = optimise(PoseGraph.of([odometry("a", poses, 1), slipping], right))
    (fault,) = answer.faults
    assert (fault.session, fault.kind, fault.first, fault.last) == ("b", FaultKind.SLIP, AT - 1, AT)
    assert apart_m(answer) < 0.3


def test_the_session_that_slipped_is_named_where_scans_are_so_far_apart_that_lengths_of_steps_alternate():
    """Submaps begin at every third or fourth scan, 1.5 m apart: 4.5, 4.5 and 6 m."""
    way, slipping = np.eye(4), FAULTS["a slip of 5 m"][2]
    poses = [way := way @ se3.from_yaw(0.01, (6.0 if k % 3 == 0 else 4.5, 0.0, 0.0)) for k in range(SUBMAPS)]
    drives = [odometry("a", np.stack(poses), 1), odometry("b", np.stack(poses), 2, slipping)]
    right = [one for one in loops(np.stack(poses)) if one.match.ordinal not in range(AT - 5, AT + 6)]
    (fault,) = optimise(PoseGraph.of(drives, right)).faults
    assert (fault.session, fault.kind, fault.first, fault.last) == ("b", FaultKind.SLIP, AT - 1, AT)


def short_drive(wrong: Motion = lambda _, motion: motion) -> PoseGraph:
    """Two drives, of which loops show eight submaps behind AT: one place."""
    poses = winding_way(AT + 15)
    right = [one for one in loops(poses) if one.match.ordinal not in range(AT - 7, AT + 7)]
    return PoseGraph.of([odometry("a", poses, 1), odometry("b", poses, 2, wrong)], right)


@pytest.mark.parametrize("name", ["a slip of 5 m", "a jump of 10 m", "a turn of 20 degrees"])
def test_a_fault_that_loops_of_one_place_show_is_undecided_and_the_poses_are_as_unsure_as_it_is_large(name):
    kind, amount, wrong = FAULTS[name]
    graph = short_drive(wrong)
    answer = optimise(graph)
    (fault,) = answer.faults
    assert (fault.session, fault.kind, fault.undecided) == ("b", kind, True)
    assert fault.amount == pytest.approx(amount, rel=0.1, abs=0.15)
    sigma = np.sqrt(np.trace(answer.covariances["b"][:, :3, :3], axis1=1, axis2=2))
    gaps = np.linalg.inv(answer.T_map_submap["a"]) @ answer.T_map_submap["b"]
    off = np.linalg.norm(gaps[:, :3, 3], axis=1)
    assert off.max() > 1.0 and (off < sigma + 0.2).all()
    mended = answer.otherwise
    assert set(mended.loops) == {GraphState.IN_MAP} and mended.faults == answer.faults
    assert apart_m(mended) < 0.3


def test_a_turn_of_a_robot_that_was_lifted_is_undecided_however_many_loops_show_it():
    poses = winding_way()
    drives = [odometry("a", poses, 1), odometry("b", poses, 2, at_once(se3.from_yaw(np.radians(90.0))))]
    answer = optimise(PoseGraph.of(drives, loops(poses)))
    (fault,) = answer.faults
    assert (fault.session, fault.kind, fault.first, fault.last, fault.undecided) == ("b", FaultKind.TURN, 39, 40, True)
    assert set(answer.otherwise.loops) == {GraphState.IN_MAP} and apart_m(answer.otherwise) < 0.3


def test_an_undecided_fault_of_a_large_graph_is_told_without_a_second_answer(monkeypatch):
    monkeypatch.setattr(optimisation, "MOST_SOLVED_TWICE", 10)
    _, _, wrong = FAULTS["a slip of 5 m"]
    answer = optimise(short_drive(wrong))
    (fault,) = answer.faults
    assert fault.undecided and answer.otherwise is None
    assert len(optimise(short_drive()).faults) == 0


def test_a_short_drive_with_good_odometry_has_nothing_undecided():
    answer = optimise(short_drive())
    assert (answer.faults, answer.otherwise) == ((), None)


def misplaced(stretch: range, aside_m: float) -> list[LoopEdge]:
    """Loops at every submap, right ones but for a stretch that is taken for one `aside_m` beside it."""
    poses, aside = winding_way(), se3.from_yaw(0.0, (0.0, aside_m, 0.0))
    found = loops(poses)
    for k in stretch:
        moved = se3.inverse(poses[k]) @ aside @ poses[k] @ found[k].T_match_query
        found[k] = replace(found[k], name=f"wrong-{k}", T_match_query=moved)
    return found


@pytest.mark.parametrize(
    ("stretch", "aside_m"),
    [(range(30, 45), 8.0), (range(65, 80), 8.0), (range(45, 80), 40.0)],
    ids=["one place", "one place at the end", "a street beside it"],
)
def test_a_place_taken_for_another_one_is_no_fault_and_not_in_the_map(stretch: range, aside_m: float) -> None:
    poses = winding_way()
    graph = PoseGraph.of([odometry("a", poses, 1), odometry("b", poses, 2)], misplaced(stretch, aside_m))
    answer = optimise(graph)
    assert all(one.undecided for one in answer.faults)
    kept = {loop.name for loop, state in zip(graph.loops, answer.loops, strict=True) if state is GraphState.IN_MAP}
    assert not any(name.startswith("wrong") for name in kept)


@pytest.mark.parametrize("stretch", [range(30, 45), range(45, 80)])
def test_a_place_that_looks_alike_from_another_side_is_no_fault_beyond_doubt_and_not_in_the_map(stretch: range) -> None:
    """A stretch of loops turned by 90 degrees about its middle."""
    poses, found = winding_way(), loops(winding_way())
    middle = poses[stretch[len(stretch) // 2]]
    turn = middle @ se3.from_yaw(np.pi / 2.0) @ se3.inverse(middle)
    for k in stretch:
        moved = se3.inverse(poses[k]) @ turn @ poses[k] @ found[k].T_match_query
        found[k] = replace(found[k], name=f"wrong-{k}", T_match_query=moved)
    graph = PoseGraph.of([odometry("a", poses, 1), odometry("b", poses, 2)], found)
    answer = optimise(graph)
    assert all(one.undecided for one in answer.faults)
    kept = {loop.name for loop, state in zip(graph.loops, answer.loops, strict=True) if state is GraphState.IN_MAP}
    assert not any(name.startswith("wrong") for name in kept)


@pytest.mark.parametrize("stretch", [range(25, 50), range(22, 60)])
def test_odometry_that_would_be_wrong_twice_and_right_again_is_not_at_fault(stretch: range) -> None:
    poses = winding_way()
    graph = PoseGraph.of([odometry("a", poses, 1), odometry("b", poses, 2)], misplaced(stretch, 8.0))
    assert optimise(graph).faults == ()


def test_a_fault_is_the_same_in_any_order_to_a_bit() -> None:
    poses = winding_way()
    tracks, right = [odometry("a", poses, 1), odometry("b", poses, 2, FAULTS["a slip of 5 m"][2])], loops(poses)
    one, other = optimise(PoseGraph.of(tracks, right)), optimise(PoseGraph.of(tracks[::-1], right[::-1]))
    assert one.faults == other.faults
    for name, its in one.T_map_submap.items():
        assert its.tobytes() == other.T_map_submap[name].tobytes()


def test_sessions_of_one_submap_each_are_optimised_and_nothing_is_bent():
    alone = [Trajectory.from_odometry(name, np.eye(4)[None]) for name in ("a", "b")]
    graph = PoseGraph(tuple(alone), ())
    assert not is_bent(graph, (), {one.session: one.T_odom_submap for one in alone})
    assert len(optimise(graph).components) == 2


@pytest.mark.parametrize("seed", [4, 19])
def test_a_place_taken_for_another_one_makes_up_no_small_faults_of_sound_drives(seed: int) -> None:
    """The last 15 submaps of a drive lie 9 m aside by their loops; all odometry is as good as it states."""
    made, aside = fleet(seed, 0.0, sessions=3, submaps=100, per_pair=40), se3.from_yaw(0.0, (0.0, 9.0, 0.0))

    def misplaced(loop: LoopEdge) -> LoopEdge:
        match, query = (
            aside @ made.truth[one.session][one.ordinal]
            if one.session == "s1"
            else made.truth[one.session][one.ordinal]
            for one in (loop.match, loop.query)
        )
        is_there = any(one.session == "s1" and one.ordinal >= 85 for one in (loop.match, loop.query))
        return replace(loop, T_match_query=se3.inverse(match) @ query) if is_there else loop

    answer = optimise(replace(made.graph, loops=tuple(misplaced(one) for one in made.graph.loops)))
    (fault,) = answer.faults
    assert (fault.session, fault.kind, fault.undecided) == ("s1", FaultKind.SLIP, True)
