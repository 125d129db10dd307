"""Pose graphs: oracles for consistency, covariances and g2o; fleets with wrong loops; recorded graphs."""

from __future__ import annotations

import itertools
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from lab.pose_graphs.benchmark import Case, Spoiling, measure
from lab.pose_graphs.g2o_reading import read_g2o
from lab.pose_graphs.wrong_loops import is_wrong, with_agreeing_loops
from revisit.core.errors import BadField, MalformedBody
from revisit.core.geometry import se3
from revisit.core.pose_graph import consistency, independence, optimisation
from revisit.core.pose_graph.consistency import agreement, consistent_sets, largest_clique, oriented
from revisit.core.pose_graph.g2o import write_g2o
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, PoseGraph, Trajectory, loop_covariance
from revisit.core.pose_graph.least_squares import INLIER, cauchy, graduated, huber, minimise, settled
from revisit.core.pose_graph.normal_equations import Edges
from revisit.core.pose_graph.optimisation import Robustness, optimise
from revisit.core.pose_graph.support import STRETCH, LoopsWithin
from revisit.core.pose_graph.variance_factor import Side, rescaled, squared_errors, variance_factor
from revisit.evaluation.real_data import real_data
from tests.support.made_up_fleet import LOOP_COVARIANCE, MODEL, drifted, fleet, random_motion, road
from tests.support.real_data import needs_real_data


def in_map(graph: PoseGraph, states: tuple[GraphState, ...]) -> list[str]:
    return [loop.name for loop, state in zip(graph.loops, states, strict=True) if state is GraphState.IN_MAP]


@pytest.mark.parametrize("wrong_share", [0.0, 0.1, 0.5, 0.8])
def test_a_commit_keeps_right_loops_and_no_wrong_one(wrong_share: float) -> None:
    made = fleet(3, wrong_share)
    result = optimise(made.graph, Robustness.COMMIT)
    kept = in_map(made.graph, result.loops)
    right = [loop for loop in made.graph.loops if loop.name.startswith("right")]
    assert not [name for name in kept if name.startswith("wrong")]
    assert len(kept) >= 0.95 * len(right)
    assert len(result.components) == 1
    clean = optimise(PoseGraph.of(list(made.graph.trajectories), right), Robustness.PLAIN)
    assert made.error_m(result.T_map_submap) <= 1.1 * made.error_m(clean.T_map_submap)


def test_a_second_answer_is_sought_where_not_every_loop_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def watched(problem: optimisation.Problem, usable: set[int]) -> np.ndarray:
        asked.append(len(usable))
        return graduated_answer(problem, usable)

    graduated_answer = optimisation._graduated
    monkeypatch.setattr(optimisation, "_graduated", watched)
    fitting, spoilt = fleet(3, 0.0).graph, fleet(3, 0.5).graph
    answer = optimise(fitting, Robustness.COMMIT)
    assert set(answer.loops) == {GraphState.IN_MAP} and answer.chi2 <= answer.degrees_of_freedom
    assert not asked
    alone = optimise(fitting, Robustness.ONLINE)
    assert all(np.array_equal(answer.T_map_submap[name], poses) for name, poses in alone.T_map_submap.items())
    assert GraphState.SET_ASIDE in optimise(spoilt, Robustness.COMMIT).loops
    assert len(asked) == 1
    # loops that all lie within their gates, but err more than they state, may agree on something else
    unsure = replace(fitting, loops=tuple(replace(one, covariance=one.covariance / 5.0) for one in fitting.loops))
    worse = optimise(unsure, Robustness.COMMIT)
    assert set(worse.loops) == {GraphState.IN_MAP} and worse.chi2 > worse.degrees_of_freedom
    assert len(asked) == 2


def test_circles_and_shares_are_the_same_however_many_are_computed_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made = fleet(7, 0.5, sessions=2)
    loops = [oriented(loop, "s0") for loop in made.graph.loops]
    agree, shares = agreement(loops, *made.graph.trajectories), independence.weighed(made.graph, 30.0)
    monkeypatch.setattr(consistency, "_CIRCLES_AT_ONCE", 3 * len(loops) + 1)
    monkeypatch.setattr(independence, "_PAIRS_AT_ONCE", 1)
    assert np.array_equal(agreement(loops, *made.graph.trajectories), agree)
    assert independence.weighed(made.graph, 30.0).loops == shares.loops
    beside = [one for one in made.graph.loops if one.match.session == "s0"]
    ends = np.array([[made.graph.by_session[node.session].T_odom_submap[node.ordinal, :3, 3]
                      for node in (one.match, one.query)] for one in beside])  # fmt: skip
    told = {one.name: one.independent_share for one in shares.loops}
    for row, one in enumerate(beside):
        assert told[one.name] == pytest.approx(independence.share_beside(ends[row], np.delete(ends, row, 0), 30.0))
    assert min(told.values()) < 0.9


def test_wrong_loops_within_a_session_are_set_aside() -> None:
    graph = _twice_around()
    for robustness in (Robustness.ONLINE, Robustness.COMMIT):
        kept = in_map(graph, optimise(graph, robustness).loops)
        assert len(kept) >= 19 and all(name.startswith("right") for name in kept), robustness
    bent = optimise(graph, Robustness.PLAIN).T_map_submap["s"][:, :3, 3]
    good = optimise(graph, Robustness.COMMIT).T_map_submap["s"][:, :3, 3]
    assert np.linalg.norm(bent - good, axis=1).max() > 10.0


def test_uncertainties_are_reduced_that_small_circles_show_to_be_far_too_large() -> None:
    made = _twice_around(wrong=8)
    assert variance_factor(made) == 1.0
    assert variance_factor(rescaled(made, 1e3)) == 1.0
    assert 0.001 < variance_factor(rescaled(made, 1e5)) < 0.1


def test_the_errors_of_circles_are_those_of_one_circle_after_the_other() -> None:
    rng = np.random.default_rng(4)
    sides = tuple(
        Side(np.stack([random_motion(rng) for _ in range(6)]), np.cumsum([np.eye(6)] * 6, axis=0)) for _ in range(2)
    )
    poses, ends = np.stack([random_motion(rng) for _ in range(4)]), rng.integers(0, 6, (4, 2))
    covariances, pairs = np.stack([(1.0 + k) * np.eye(6) for k in range(4)]), np.array([[0, 1], [2, 3], [1, 3]])
    expected = []
    for one, other in pairs:
        (a, b), (c, d) = ends[one], ends[other]
        to_second = poses[one] @ se3.inverse(sides[1].poses[b])
        to_other = to_second @ sides[1].poses[d] @ se3.inverse(poses[other])
        to_first = to_other @ se3.inverse(sides[0].poses[c])
        parts = ((to_second, abs(b - d)), (to_other, 1.0 + other), (to_first, abs(a - c)))
        turned = sum(weight * se3.adjoint(pose) @ se3.adjoint(pose).T for pose, weight in parts)
        error = se3.log(to_first @ sides[0].poses[a])
        expected.append(error @ np.linalg.solve(covariances[one] + turned, error))
    np.testing.assert_allclose(squared_errors(poses, covariances, ends, pairs, *sides), expected, rtol=1e-9)


def test_what_a_graph_states_is_believed_where_few_circles_speak_against_it() -> None:
    unsure = rescaled(_twice_around(wrong=0), 1e5)
    assert variance_factor(replace(unsure, loops=unsure.loops[:3])) == 1.0
    rng = np.random.default_rng(1)
    apart = [replace(loop, T_match_query=random_motion(rng)) for loop in unsure.loops]
    assert variance_factor(replace(unsure, loops=(*unsure.loops, *apart))) > variance_factor(unsure)


def test_one_stretch_taken_for_another_does_not_say_how_sure_a_graph_is() -> None:
    """Aliases repeat one measurement: the circles between nine of them close far better than the graph states."""
    graph = _twice_around(wrong=0)
    sparse = [loop for loop in graph.loops if loop.match.ordinal % 9 == 0]
    (track,) = graph.trajectories
    T_odom_submap, aside = track.T_odom_submap, se3.from_yaw(0.3, (15.0, 8.0, 0.0))
    motion = [se3.inverse(T_odom_submap[8]) @ T_odom_submap[8 + n] for n in range(9)]
    back = [se3.inverse(T_odom_submap[95]) @ T_odom_submap[95 + n] for n in range(9)]
    wrong = [_loop(f"wrong-{n}", 8 + n, 95 + n, se3.inverse(motion[n]) @ aside @ back[n]) for n in range(9)]
    spoilt = PoseGraph.of([track], [*sparse, *wrong])
    assert variance_factor(spoilt) == variance_factor(PoseGraph.of([track], sparse)) == 1.0
    assert in_map(spoilt, optimise(spoilt).loops) == [loop.name for loop in sparse]


def test_a_recording_that_was_sent_twice_keeps_the_loops_across_its_rounds() -> None:
    """Each submap is its own copy: circles that close exactly say nothing of how sure other loops are."""
    once = _twice_around(wrong=0)
    (track,) = once.trajectories
    copies = [LoopEdge(f"copy-{n:03d}", Node("s", n), Node("t", n), np.eye(4), LOOP_COVARIANCE) for n in range(120)]
    across = [replace(loop, query=loop.query._replace(session="t")) for loop in once.loops]
    graph = PoseGraph.of([track, replace(track, session="t")], copies + across)
    assert variance_factor(graph) == 1.0
    assert in_map(graph, optimise(graph).loops) == [loop.name for loop in graph.loops]


def _twice_around(wrong: int = 20) -> PoseGraph:
    """A drive twice around a road, 20 right loops between its rounds, and wrong ones."""
    rng = np.random.default_rng(5)
    truth = np.concatenate([road(60, 0.0, 1)] * 2)
    trajectory = Trajectory.from_odometry("s", drifted(truth, rng))
    right = [_loop(f"right-{n}", n, n + 60, se3.inverse(truth[n]) @ truth[n + 60]) for n in range(0, 60, 3)]
    ends = [(4 * n, (4 * n + int(rng.integers(30, 90))) % 120) for n in range(wrong)]
    mistaken = [_loop(f"wrong-{n}", n, m, random_motion(rng)) for n, m in ends]
    return PoseGraph.of([trajectory], right + mistaken)


def _loop(name: str, match: int, query: int, T_match_query: np.ndarray) -> LoopEdge:
    return LoopEdge(name, Node("s", match), Node("s", query), T_match_query, LOOP_COVARIANCE)


def test_the_order_of_sessions_and_loops_does_not_matter_to_a_bit() -> None:
    made = fleet(1, 0.5)
    shuffled = PoseGraph.of(list(made.graph.trajectories)[::-1], list(made.graph.loops)[::-1])
    one, other = optimise(made.graph), optimise(shuffled)
    assert one.loops == other.loops
    for name, poses in one.T_map_submap.items():
        assert poses.tobytes() == other.T_map_submap[name].tobytes()


def test_a_loop_measured_the_other_way_round_says_the_same() -> None:
    made = fleet(2, 0.0)
    turned = [oriented(loop, loop.query.session) for loop in made.graph.loops]
    one, other = optimise(made.graph), optimise(PoseGraph.of(list(made.graph.trajectories), turned))
    for name, poses in one.T_map_submap.items():
        np.testing.assert_allclose(poses, other.T_map_submap[name], atol=1e-5)


def test_sessions_that_nothing_joins_keep_frames_of_their_own() -> None:
    made = fleet(4, 0.0, sessions=2)
    alone = Trajectory.from_odometry("zz", made.graph.trajectories[0].T_odom_submap)
    single = LoopEdge("single", Node("s0", 3), Node("zz", 3), np.eye(4), LOOP_COVARIANCE)
    graph = PoseGraph.of([*made.graph.trajectories, alone], [*made.graph.loops, single])
    result = optimise(graph)
    assert result.components == (("s0", "s1"), ("zz",))
    np.testing.assert_allclose(result.T_map_submap["zz"], alone.T_odom_submap, atol=1e-6)
    state = dict(zip((loop.name for loop in graph.loops), result.loops, strict=True))
    assert state["single"] is GraphState.UNCONNECTED


def test_the_correction_of_a_session_maps_its_last_odometry_pose_into_the_map() -> None:
    made = fleet(6, 0.0)
    result = optimise(made.graph)
    for trajectory in made.graph.trajectories:
        corrected = result.T_map_odom(trajectory) @ trajectory.T_odom_submap[-1]
        np.testing.assert_allclose(corrected, result.T_map_submap[trajectory.session][-1], atol=1e-9)


def test_loops_are_weighed_by_their_covariance_in_the_frame_that_it_is_stated_in() -> None:
    """Of two loops that contradict each other the surer one wins, on the axis of the match frame on which it is."""
    turn = se3.from_yaw(np.pi / 2, (4.0, 0.0, 0.0))
    trajectory = Trajectory("s", np.stack([np.eye(4), turn]), np.eye(6)[None] * 1e4)
    sure_of_x = np.diag([1e-4, 1.0, 1.0, 1e-4, 1e-4, 1e-4])
    sure_of_y = np.diag([1.0, 1e-4, 1.0, 1e-4, 1e-4, 1e-4])
    at = [se3.from_yaw(np.pi / 2, (5.0, 1.0, 0.0)), se3.from_yaw(np.pi / 2, (3.0, 2.0, 0.0))]
    loops = [
        LoopEdge("x", Node("s", 0), Node("s", 1), at[0], sure_of_x),
        LoopEdge("y", Node("s", 0), Node("s", 1), at[1], sure_of_y),
    ]
    pose = optimise(PoseGraph.of([trajectory], loops), Robustness.PLAIN).T_map_submap["s"][1]
    np.testing.assert_allclose(pose[:2, 3], [5.0, 2.0], atol=1e-2)


def test_drift_is_what_simulated_odometry_shows() -> None:
    truth = road(40, 0.3, 1)
    rng = np.random.default_rng(0)
    runs = np.stack([drifted(truth, rng) for _ in range(120)])
    trajectory = Trajectory.from_odometry("s", truth)
    for begin in (0, 15, 30):
        expected = se3.inverse(truth[begin]) @ truth[39]
        errors = np.stack([(se3.inverse(run[begin]) @ run[39])[:3, 3] - expected[:3, 3] for run in runs])
        variance, _ = trajectory.drift(np.array([begin]), 39)
        # the turns displace across the line of sight only, which an equal variance on all axes overstates
        assert 0.5 * variance[0] < errors.var(axis=0).sum() / 3.0 < 1.2 * variance[0]


def test_the_largest_clique_is_that_of_brute_force() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        agree = np.triu(rng.random((9, 9)) < 0.5, 1)
        agree = agree | agree.T
        largest = max(
            (rows for size in range(1, 10) for rows in itertools.combinations(range(9), size)
             if all(agree[a, b] for a, b in itertools.combinations(rows, 2))), key=len)  # fmt: skip
        found = largest_clique(agree)
        assert all(agree[a, b] for a, b in itertools.combinations(found, 2))
        assert len(found) == len(largest)


def test_right_loops_agree_and_random_ones_hardly_ever() -> None:
    made = fleet(7, 0.5, sessions=2)
    loops = [oriented(loop, "s0") for loop in made.graph.loops]
    agree = agreement(loops, *made.graph.trajectories)
    right = np.array([loop.name.startswith("right") for loop in loops])

    assert agree[np.ix_(right, right)].mean() > 0.99
    assert agree[np.ix_(right, ~right)].mean() < 0.1
    (found,) = consistent_sets(made.graph)
    assert all(made.graph.loops[number].name.startswith("right") for number in found.loops)


def test_g2o_is_read_back_as_it_was_written() -> None:
    made = fleet(8, 0.0, sessions=1 + 1)
    trajectory = made.graph.trajectories[0]
    loops = [_loop(f"l{n}", n, n + 40, random_motion(np.random.default_rng(n))) for n in range(5)]
    graph = PoseGraph.of([replace(trajectory, session="s")], loops)
    text = write_g2o(graph, {"s": trajectory.T_odom_submap})
    assert text.count("FIX 0") == 1 and text.count("VERTEX_SE3:QUAT") == len(trajectory)
    back = read_g2o(text, "s")
    np.testing.assert_allclose(back.trajectories[0].step_covariances, trajectory.step_covariances, rtol=1e-6)
    for loop, other in zip(graph.loops, back.loops, strict=True):
        assert (loop.match, loop.query) == (other.match, other.query)
        np.testing.assert_allclose(other.T_match_query, loop.T_match_query, atol=1e-8)
        np.testing.assert_allclose(other.covariance, loop.covariance, rtol=1e-5, atol=1e-12)


def test_g2o_information_is_of_half_angles() -> None:
    """A rotation error of one standard deviation costs as much by g2o's own formula as by ours."""
    sigma = 0.01
    trajectory = Trajectory("s", np.stack([np.eye(4)] * 2), np.diag([1.0, 1, 1, sigma**2, sigma**2, sigma**2])[None])
    text = write_g2o(PoseGraph.of([trajectory], []), {"s": trajectory.T_odom_submap})
    numbers = [float(word) for word in next(line for line in text.splitlines() if line.startswith("EDGE")).split()[3:]]
    information = np.zeros((6, 6))
    information[np.triu_indices(6)] = numbers[7:]
    quaternion_error = np.array([0, 0, 0, 0, 0, np.sin(sigma / 2)])  # g2o: the vector part of the error's quaternion
    assert quaternion_error @ information @ quaternion_error == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(
    "text",
    [
        "EDGE_SE2 0 1 1 2",
        "VERTEX_SE2 1\nEDGE_SE2 0 2 0 0 0 1 0 0 1 0 1",
        "VERTEX_SE2 1 0 nan 0\nVERTEX_SE2 2 0 1 0\nEDGE_SE2 0 1 0 0 0 1 0 0 1 0 1",
        "VERTEX_SE2 x",
        "EDGE_SE3:QUAT a b",
        "EDGE_SE2 0 1 0 0 0 0 0 0 0 0 0",
    ],
)
def test_a_broken_g2o_graph_is_refused(text: str) -> None:
    with pytest.raises(MalformedBody):
        read_g2o(text)


@pytest.mark.parametrize(
    "edge",
    ["3 nan 0 0 1 0 0 1 0 1", "3 0 1e400 0 1 0 0 1 0 1", "3 0 0 0 -1 0 0 1 0 1", "3 0 0 0 1 2 0 1 0 1",
     "3 0 0 0 1 0 0 1 0 1 7", "3 1e200 0 0 1 0 0 1 0 1"],
    ids=["NaN", "infinite", "negative information", "indefinite information", "a number too many", "far away"],
)  # fmt: skip
def test_an_edge_that_is_no_measurement_is_refused_and_named(edge: str) -> None:
    steps = "".join(f"EDGE_SE2 {n} {n + 1} 1 0 0 1 0 0 1 0 1\n" for n in range(3))
    with pytest.raises(MalformedBody, match=f"EDGE_SE2 0 {edge[:5]}"):
        read_g2o(f"{steps}EDGE_SE2 0 {edge}\n")


def test_g2o_in_any_order_and_numbering_is_the_same_graph() -> None:
    information = "900 90 9 800 8 40000"
    lines = [f"EDGE_SE2 {n} {n + 1} 1 0.1 0.3 {information}" for n in range(4)] + [
        f"EDGE_SE2 0 4 2 2 1.2 {information}"
    ]
    graph = read_g2o("\n".join(lines))
    numbered = [
        " ".join([w[0], str(10 * int(w[1]) + 7), str(10 * int(w[2]) + 7), *w[3:]]) for w in map(str.split, lines)
    ]
    for text in ("\r\n".join(numbered[::-1]), "\n".join(numbered * 2), "# made up\n" + "\n".join(numbered)):
        other = read_g2o(text)
        np.testing.assert_array_equal(other.trajectories[0].T_odom_submap, graph.trajectories[0].T_odom_submap)
        assert [(one.match, one.query) for one in other.loops] == [(one.match, one.query) for one in graph.loops]


def test_a_step_that_no_edge_states_lies_where_the_vertices_say_and_binds_nothing() -> None:
    """As in a recording of several parts: loops, not the gap, say where its second part lies."""
    vertices = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (9.0, 5.0, 1.5), (9.0, 6.0, 1.5)]
    lines = [f"VERTEX_SE2 {7 * n} {x} {y} {yaw}" for n, (x, y, yaw) in enumerate(vertices)]
    edges = [(0, 7, 1, 0, 0), (14, 21, 1, 0, 0), (0, 14, 0, 2, 0), (7, 21, 0, 2, 0)]
    lines += [f"EDGE_SE2 {a} {b} {x} {y} {yaw} 100 0 0 100 0 100" for a, b, x, y, yaw in edges]
    graph = read_g2o("\n".join(lines))
    (track,) = graph.trajectories
    np.testing.assert_allclose(track.T_odom_submap[2], se3.from_yaw(1.5, (9.0, 5.0, 0.0)), atol=1e-9)
    assert [(one.match.ordinal, one.query.ordinal) for one in graph.loops] == [(0, 2), (1, 3)]
    answer = optimise(graph)
    assert set(answer.loops) == {GraphState.IN_MAP}
    placed = answer.T_map_submap["g2o"][:, :2, 3]
    np.testing.assert_allclose(placed, [(0, 0), (1, 0), (0, 2), (1, 2)], atol=1e-4)


def test_a_step_that_is_written_backwards_is_a_step() -> None:
    there = se3.from_yaw(0.3, (1.0, 0.1, 0.0))
    back = se3.inverse(there)
    yaw = float(np.arctan2(back[1, 0], back[0, 0]))
    graph = read_g2o(f"EDGE_SE2 1 0 {back[0, 3]} {back[1, 3]} {yaw} 1 0 0 1 0 1\n")
    np.testing.assert_allclose(graph.trajectories[0].T_odom_submap[1], there, atol=1e-12)


def test_a_loop_to_nowhere_is_refused() -> None:
    made = fleet(9, 0.0, sessions=2)
    for end in (Node("s0", 999), Node("nobody", 0), made.graph.loops[0].match):
        with pytest.raises(BadField):
            PoseGraph.of(list(made.graph.trajectories), [replace(made.graph.loops[0], query=end)])


NO_COVARIANCES = {
    "not a number": np.full((6, 6), np.nan),
    "infinite": np.diag([np.inf] + [1.0] * 5),
    "indefinite": np.diag([-0.01] + [1.0] * 5),
    "singular": np.zeros((6, 6)),
}


@pytest.mark.parametrize("covariance", NO_COVARIANCES.values(), ids=NO_COVARIANCES)
def test_what_is_no_covariance_is_refused(covariance: np.ndarray) -> None:
    made = fleet(9, 0.0, sessions=2)
    spoilt = replace(made.graph.loops[0], name="right-0", covariance=covariance)
    with pytest.raises(BadField, match="right-0"):
        PoseGraph.of(list(made.graph.trajectories), [*made.graph.loops[1:], spoilt])
    track = made.graph.trajectories[0]
    steps = np.concatenate([track.step_covariances[:4], covariance[None], track.step_covariances[5:]])
    with pytest.raises(BadField, match="step 4 of s0"):
        PoseGraph.of([replace(track, step_covariances=steps)], [])


@pytest.mark.parametrize("name", ["not a number", "infinite", "indefinite"])
def test_a_floor_mends_no_covariance_that_is_none(name: str) -> None:
    with pytest.raises(BadField, match="covariance"):
        loop_covariance(NO_COVARIANCES[name])


def test_poses_that_are_not_finite_are_refused() -> None:
    made = fleet(9, 0.0, sessions=2)
    nowhere = np.full((4, 4), np.nan)
    with pytest.raises(BadField, match="T_match_query"):
        PoseGraph.of(list(made.graph.trajectories), [replace(made.graph.loops[0], T_match_query=nowhere)])
    track = made.graph.trajectories[0]
    poses = np.concatenate([track.T_odom_submap[:-1], nowhere[None]])
    with pytest.raises(BadField, match="submap 79 of s0"):
        PoseGraph.of([replace(track, T_odom_submap=poses)], [])


@pytest.mark.slow
@pytest.mark.real_data
@needs_real_data
def test_half_wrong_loops_do_not_move_a_recorded_graph() -> None:
    graph = read_g2o((real_data() / "graphs/kitti_05.g2o").read_text())
    # with this seed graduated non-convexity alone sets every loop aside
    rng, (trajectory,) = np.random.default_rng(4), graph.trajectories
    wrong = []
    while len(wrong) < len(graph.loops):
        first, second = sorted(int(end) for end in rng.choice(len(trajectory), 2, replace=False))
        ends = Node("g2o", first), Node("g2o", second)
        if second - first > 50:
            wrong.append(LoopEdge(f"wrong-{len(wrong)}", *ends, random_motion(rng), graph.loops[0].covariance))
    spoilt = PoseGraph.of([trajectory], [*graph.loops, *wrong])
    best = optimise(graph, Robustness.PLAIN).T_map_submap["g2o"][:, :3, 3]
    for robustness in (Robustness.ONLINE, Robustness.COMMIT):
        result = optimise(spoilt, robustness)
        assert not [name for name in in_map(spoilt, result.loops) if name.startswith("wrong")]
        gap = result.T_map_submap["g2o"][:, :3, 3] - best
        assert np.sqrt(np.mean(np.sum(gap**2, axis=1))) < 0.1


@pytest.mark.slow
@pytest.mark.real_data
@needs_real_data
def test_wrong_loops_do_not_bend_a_recorded_graph_that_states_far_too_large_uncertainties() -> None:
    file = real_data() / "graphs/parking-garage.g2o"
    outcome = measure(Case(file, Spoiling(0.5), Robustness.ONLINE))
    assert outcome.wrong_kept == 0 and outcome.right_kept >= 0.999 * outcome.right
    assert outcome.distance_m < 0.1


def test_covariances_of_a_straight_drive_are_the_sums_of_its_steps() -> None:
    T_odom_submap = np.tile(np.eye(4), (4, 1, 1))
    T_odom_submap[:, 0, 3] = [0.0, 5.0, 10.0, 15.0]
    graph = PoseGraph.of([Trajectory.from_odometry("a", T_odom_submap)], [])
    optimised = optimise(graph)
    step = MODEL.covariances(np.array([5.0]))[0]
    along = [optimised.covariances["a"][n][0, 0] for n in range(4)]
    assert along == pytest.approx([n * step[0, 0] + 1e-8 for n in range(4)], rel=1e-6)
    turns = sum(step[5, 5] * distance_m**2 for distance_m in (10.0, 5.0, 0.0))
    across = 3 * step[1, 1] + turns + 1e-8 + 1e-8 * 15.0**2
    assert optimised.covariances["a"][3][1, 1] == pytest.approx(across, rel=1e-6)
    assert (optimised.chi2, optimised.degrees_of_freedom) == (pytest.approx(0.0, abs=1e-9), 0)


def test_chi2_of_right_loops_is_about_its_degrees_of_freedom() -> None:
    optimised = optimise(fleet(3, 0.0).graph)
    kept = optimised.loops.count(GraphState.IN_MAP)
    assert optimised.degrees_of_freedom == 6 * (kept - 3 + 1)
    assert 0.7 < optimised.chi2 / optimised.degrees_of_freedom < 1.3


def test_aliases_within_a_session_that_agree_with_each_other_are_set_aside() -> None:
    """Four of five loops are wrong, in runs of 20 that agree; the odometry between their ends says no."""
    rng = np.random.default_rng(8)
    truth = np.concatenate([road(200, 0.0, 1)] * 2)
    right = [_loop(f"right-{n}", n, n + 200, se3.inverse(truth[n]) @ truth[n + 200]) for n in range(0, 200, 4)]
    made = PoseGraph.of([Trajectory.from_odometry("s", drifted(truth, rng))], right)
    spoilt = with_agreeing_loops(made, 0.8, seed=3)
    assert sum(map(is_wrong, spoilt.loops)) == 200
    for robustness in (Robustness.ONLINE, Robustness.COMMIT):
        kept = in_map(spoilt, optimise(spoilt, robustness).loops)
        assert all(name.startswith("right") for name in kept), robustness
        assert len(kept) >= 0.95 * len(right), robustness


def test_where_loops_are_more_than_submaps_some_speak_for_all_that_agree_with_them() -> None:
    """Three loops a submap, and four wrong ones for each: the first solution rests on one a stretch of each run."""
    truth = np.concatenate([road(100, 0.0, 1)] * 2)
    right = [_loop(f"right-{n}-{k}", n, n + 100 + k, se3.inverse(truth[n]) @ truth[n + 100 + k])
             for n in range(96) for k in range(4)]  # fmt: skip
    trajectory = Trajectory.from_odometry("s", drifted(truth, np.random.default_rng(8)))
    graph = PoseGraph.of([trajectory], right)
    within = LoopsWithin.of(graph)
    queries = sorted(graph.loops[number].query.ordinal for number in within.speakers)
    assert len({ordinal // STRETCH for ordinal in queries}) == len(queries) == 5
    assert {number for others in within.speakers.values() for number in others} == within.supported
    spoilt = with_agreeing_loops(graph, 0.8, seed=3)
    kept = in_map(spoilt, optimise(spoilt, Robustness.ONLINE).loops)
    assert all(name.startswith("right") for name in kept) and len(kept) >= 0.95 * len(right)


def test_a_single_right_loop_that_nothing_supports_is_used() -> None:
    truth = np.concatenate([road(60, 0.0, 1)] * 2)
    trajectory = Trajectory.from_odometry("s", drifted(truth, np.random.default_rng(2)))
    alone = _loop("alone", 0, 60, se3.inverse(truth[0]) @ truth[60])
    result = optimise(PoseGraph.of([trajectory], [alone]), Robustness.ONLINE)
    assert result.loops == (GraphState.IN_MAP,)


def test_a_loop_that_the_odometry_forbids_is_not_used_even_alone() -> None:
    truth = np.concatenate([road(60, 0.0, 1)] * 2)
    trajectory = Trajectory.from_odometry("s", drifted(truth, np.random.default_rng(2)))
    apart = se3.inverse(truth[0]) @ truth[30]
    result = optimise(PoseGraph.of([trajectory], [_loop("alone", 0, 60, apart)]), Robustness.COMMIT)
    assert result.loops == (GraphState.SET_ASIDE,)


@pytest.mark.slow
def test_errors_of_the_last_poses_are_as_large_as_their_covariances_say() -> None:
    """Normalised squared errors of 60 last poses in their first session's frame: 95 % are below chi-square's 95 %."""
    below = []
    for seed in range(30):
        made = fleet(seed, 0.0, submaps=50, per_pair=10)
        result = optimise(made.graph, Robustness.ONLINE)
        origin = result.T_map_submap["s0"][0] @ se3.inverse(made.truth["s0"][0])
        for name in ("s1", "s2"):
            error = se3.log(se3.inverse(result.T_map_submap[name][-1]) @ origin @ made.truth[name][-1])
            below.append(error @ np.linalg.solve(result.covariances[name][-1], error) < 12.59)
    assert np.mean(below) >= 0.9


def test_the_solver_ends_where_gtsam_ends() -> None:
    edges, start = _ring()
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(start[0]), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    for row in range(len(edges)):
        motion = gtsam.Pose3(se3.inverse(edges.T_second_first[row]))
        noise = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
        factors.add(gtsam.BetweenFactorPose3(int(edges.first[row]), int(edges.second[row]), motion, noise))
    for key, pose in enumerate(start):
        values.insert(key, gtsam.Pose3(pose))
    theirs = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    found = settled(edges, 0, minimise(edges, 0, start))
    assert edges.squared_errors(found).sum() < 0.5 * edges.squared_errors(start).sum()
    assert np.array_equal(found[0], start[0])
    np.testing.assert_allclose(found, [theirs.atPose3(key).matrix() for key in range(12)], atol=1e-4)
    assert edges.squared_errors(found).sum() <= 2.0 * factors.error(theirs) + 1e-9


def test_what_pulls_at_the_anchor_moves_no_map() -> None:
    near, start = _ring()
    motions, start = near.T_second_first.copy(), start.copy()
    motions[:, :3, 3] *= 100.0  # a ring of 800 m whose steps are known to a millimetre and a milliradian
    start[:, :3, 3] *= 100.0
    edges = Edges(near.first, near.second, motions, 1e4 * near.information)
    found = settled(edges, 0, minimise(edges, 0, start))
    again = settled(edges, 0, found)
    assert np.abs(again - found).max() < 1e-6


def test_kernels_cost_as_gtsams_do() -> None:
    distances = np.array([0.0, 0.5, 1.345, 2.0, 30.0])
    estimators = gtsam.noiseModel.mEstimator
    for own, theirs in ((cauchy, estimators.Cauchy.Create(1.0)), (huber, estimators.Huber.Create(1.345))):
        costs, weights = own(distances**2)
        np.testing.assert_allclose(0.5 * costs, [theirs.loss(one) for one in distances], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(weights, [theirs.weight(one) for one in distances], rtol=1e-12)


def test_poses_that_nothing_holds_together_stay_as_they_are() -> None:
    edges, start = _ring()
    apart = edges.chosen(np.arange(4))
    assert np.array_equal(settled(apart, 0, start), start)
    assert np.array_equal(minimise(edges.weighted(np.full(len(edges), np.nan)), 0, start), start)


def test_graduated_non_convexity_gives_wrong_loops_no_weight() -> None:
    steps, start = _ring()
    right = [(n, n + 6, se3.inverse(_ring_pose(n)) @ _ring_pose(n + 6)) for n in range(6)]
    wrong = [(n, n + 5, se3.from_yaw(float(n), (9.0, float(n), 0.0))) for n in (1, 4)]
    ends, motions = [(a, b) for a, b, _ in right + wrong], [motion for *_, motion in right + wrong]
    loops = Edges.of_motions(ends, motions, [0.05**2 * np.eye(6)] * 8)
    costs = 0.5 * loops.squared_errors(graduated(steps.joined(loops), len(steps), 0, start))
    assert (costs[:6] < INLIER).all() and (costs[6:] > INLIER).all()


def _ring_pose(n: int) -> np.ndarray:
    angle = 2 * np.pi * n / 12
    return se3.from_yaw(angle, (8 * np.cos(angle), 8 * np.sin(angle), 0.0))


def _ring() -> tuple[Edges, np.ndarray]:
    """The steps of twelve poses on a ring that closes, and a start that is off."""
    rng = np.random.default_rng(0)
    start = np.array([_ring_pose(n) @ se3.exp(0.1 * rng.normal(size=6)) for n in range(12)])
    ends = [(n, (n + 1) % 12) for n in range(12)]
    motions = [se3.inverse(_ring_pose(a)) @ _ring_pose(b) @ se3.exp(0.004 * rng.normal(size=6)) for a, b in ends]
    return Edges.of_motions(ends, motions, [0.1**2 * np.eye(6)] * 12), start


def laps_of_one_drive(stated: float) -> PoseGraph:
    """Four laps of one road with a right loop at each submap to one and two laps before, and two wrong loops 2 m off.

    All covariances are `stated` times those of the errors.
    """
    rng, submaps = np.random.default_rng(6), 60
    truth = np.concatenate([road(submaps, 0.0, 1)] * 4)
    steps = Trajectory.from_odometry("s", drifted(truth, rng), MODEL)
    ends = [(k, k + gap) for gap in (submaps, 2 * submaps) for k in range(len(truth) - gap)]
    noise = rng.multivariate_normal(np.zeros(6), LOOP_COVARIANCE, size=len(ends))
    loops = [
        LoopEdge(f"right-{n}", Node("s", a), Node("s", b), se3.exp(noise[n]), stated * LOOP_COVARIANCE)
        for n, (a, b) in enumerate(ends)
    ]
    aside = se3.from_yaw(0.0, (2.0, 0.0, 0.0))
    loops += [
        LoopEdge(f"wrong-{k}", Node("s", k), Node("s", k + submaps), aside, stated * LOOP_COVARIANCE) for k in (30, 31)
    ]
    return PoseGraph.of([replace(steps, step_covariances=stated * steps.step_covariances)], loops)


@pytest.mark.parametrize("stated", [1.0, 100.0])
@pytest.mark.parametrize("robustness", [Robustness.ONLINE, Robustness.COMMIT])
def test_loops_are_judged_by_how_well_a_graph_fits_where_it_states_far_less(
    stated: float, robustness: Robustness
) -> None:
    graph = laps_of_one_drive(stated)
    kept = in_map(graph, optimise(graph, robustness).loops)
    assert not [name for name in kept if name.startswith("wrong")]
    assert len(kept) >= 0.99 * (len(graph.loops) - 2)


def test_a_graph_that_states_its_errors_is_judged_by_these(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = laps_of_one_drive(1.0)
    found = optimise(graph, Robustness.COMMIT)
    monkeypatch.setattr(optimisation, "LEAST_PLACES", len(graph.loops))
    assert optimise(graph, Robustness.COMMIT).T_map_submap["s"].tobytes() == found.T_map_submap["s"].tobytes()
