"""Anchors place a map on earth and hold it there; wrong ones are set aside, and weak ones change nothing. Simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.errors import BadField
from revisit.core.geometry import se3, se3_rows
from revisit.core.pose_graph.absolute_edges import AbsoluteEdges, GroundedEdges
from revisit.core.pose_graph.anchors import Anchor, AnchorReason, AnchorState, Heading
from revisit.core.pose_graph.graph import Node, PoseGraph, Trajectory
from revisit.core.pose_graph.normal_equations import Edges
from revisit.core.pose_graph.optimisation import OptimisedGraph, optimise
from tests.support.made_up_anchors import error_m, fixes, right
from tests.support.made_up_fleet import Fleet, drifted, fleet


def reasons(answer: OptimisedGraph) -> set[AnchorReason | None]:
    return {one.reason for one in answer.anchors}


def straight(submaps: int) -> Fleet:
    """A drive along a corridor, one submap in 5 m."""
    truth = np.stack([se3.from_yaw(0.4, (5.0 * k * np.cos(0.4), 5.0 * k * np.sin(0.4), 0.0)) for k in range(submaps)])
    track = Trajectory.from_odometry("s0", drifted(truth, np.random.default_rng(1)))
    return Fleet(PoseGraph.of([track], []), {"s0": truth})


@pytest.mark.parametrize("street", [1, pytest.param(8, marks=pytest.mark.slow)])
def test_a_fleet_with_reflected_fixes_lies_where_it_is_on_earth(street: int) -> None:
    made = fleet(1, 0.2, sessions=5, submaps=80)
    anchors = []
    for n, sigma_m in enumerate((1.0, 1.5, 2.0, 2.5, 3.0)):
        for second in (0, 1):  # two fixes in 5 m
            anchors += fixes(made, 2 * n + second, sigma_m, 0.2, street, sessions=(f"s{n}",))
    answer, without = optimise(made.graph, anchors=anchors), optimise(made.graph, anchors=right(anchors))
    kept = [one for one, found in zip(anchors, answer.anchors, strict=True) if found.state is AnchorState.IN_MAP]
    assert len(kept) == len(right(kept)) >= 0.98 * len(right(anchors))
    assert error_m(made, answer) <= 0.5 and error_m(made, answer) <= 1.1 * error_m(made, without)
    assert reasons(answer) == {None, AnchorReason.DISAGREES}
    assert answer.loops == optimise(made.graph).loops


def test_a_long_drive_without_loops_is_held_by_its_fixes() -> None:
    made = fleet(2, 0.0, sessions=1, submaps=120)
    drift = made.error_m(optimise(made.graph).T_map_submap)
    answer = optimise(made.graph, anchors=fixes(made, 2, 1.0, 0.2, 8))
    assert error_m(made, answer) <= 1.0 <= 0.25 * drift


def test_a_graph_without_anchors_is_the_same_bit_for_bit() -> None:
    made = fleet(3, 0.5)
    plain, asked = optimise(made.graph), optimise(made.graph, anchors=())
    assert all(np.array_equal(plain.T_map_submap[name], poses) for name, poses in asked.T_map_submap.items())
    assert (plain.loops, plain.chi2, asked.anchors, asked.georeferences) == (asked.loops, asked.chi2, (), ())


@pytest.mark.parametrize(
    ("submaps", "sigma_m", "every", "reason"),
    [
        (8, 3.0, 1, AnchorReason.NOT_SPREAD),
        (60, 1.0, 25, AnchorReason.TOO_FEW),
    ],
)
def test_weak_anchors_are_told_and_change_nothing(
    submaps: int, sigma_m: float, every: int, reason: AnchorReason
) -> None:
    made = straight(submaps)
    plain, answer = optimise(made.graph), optimise(made.graph, anchors=fixes(made, 5, sigma_m)[::every])
    assert {(one.state, one.reason) for one in answer.anchors} == {(AnchorState.NOT_ALIGNED, reason)}
    assert np.array_equal(plain.T_map_submap["s0"], answer.T_map_submap["s0"])
    assert np.array_equal(plain.covariances["s0"], answer.covariances["s0"])
    assert answer.georeferences == () and answer.chi2 == plain.chi2


def test_anchors_that_contradict_each_other_change_nothing() -> None:
    made = fleet(4, 0.0, sessions=2, submaps=40)
    rng = np.random.default_rng(4)
    anchors = [replace(one, place_world=rng.uniform(-200, 200, 3)) for one in fixes(made, 4, 1.0)]
    plain, answer = optimise(made.graph), optimise(made.graph, anchors=anchors)
    assert reasons(answer) == {AnchorReason.MOSTLY_DISAGREE}
    assert all(np.array_equal(plain.T_map_submap[name], poses) for name, poses in answer.T_map_submap.items())


def test_control_points_straighten_a_drive_but_for_one_that_was_misread() -> None:
    made = fleet(6, 0.0, sessions=1, submaps=120)
    surveyed = [replace(one, covariance=0.03**2 * np.eye(3)) for one in fixes(made, 6, 0.03)[::15]]
    surveyed[3] = replace(surveyed[3], place_world=surveyed[5].place_world)
    answer = optimise(made.graph, anchors=surveyed)
    assert [one.state for one in answer.anchors].index(AnchorState.SET_ASIDE) == 3
    assert sum(one.state is AnchorState.IN_MAP for one in answer.anchors) == len(surveyed) - 1
    assert np.linalg.norm(answer.anchors[3].residual_m) > 10.0
    assert error_m(made, answer) < 0.2 * made.error_m(optimise(made.graph).T_map_submap)


def test_a_known_start_places_a_map_and_leaves_its_form() -> None:
    made = fleet(7, 0.0, sessions=2, submaps=40)
    session, poses = next(iter(made.truth.items()))
    heading = Heading(np.array([1.0, 0.0, 0.0]), se3.yaw(poses[0]), np.radians(0.5))
    start = Anchor("start", Node(session, 0), np.zeros(3), poses[0, :3, 3], 0.01 * np.eye(3), heading)
    plain, answer = optimise(made.graph), optimise(made.graph, anchors=[start])
    assert [one.state for one in answer.anchors] == [AnchorState.IN_MAP]
    assert all(np.allclose(plain.T_map_submap[name], it, atol=1e-4) for name, it in answer.T_map_submap.items())
    assert np.allclose(answer.georeferences[0].T_world_map @ answer.T_map_submap[session][0], poses[0], atol=1e-4)
    assert answer.degrees_of_freedom == plain.degrees_of_freedom, "place and heading: as much as the map was free to"


def test_a_drive_without_loops_that_begins_at_a_known_pose_has_no_degrees_of_freedom() -> None:
    made = straight(2)
    heading = Heading(np.array([1.0, 0.0, 0.0]), 0.4, np.radians(0.5))
    start = Anchor("start", Node("s0", 0), np.zeros(3), np.zeros(3), 0.01 * np.eye(3), heading)
    answer = optimise(made.graph, anchors=[start])
    assert [one.state for one in answer.anchors] == [AnchorState.IN_MAP] and answer.degrees_of_freedom == 0


def test_the_first_pose_stays_and_the_covariance_of_the_georeference_covers_its_error() -> None:
    made = fleet(8, 0.2, sessions=2, submaps=60)
    distances = []
    for seed in range(6):
        answer = optimise(made.graph, anchors=fixes(made, seed, 2.0))
        (found,) = answer.georeferences
        T_world_first = made.truth[found.session][0]
        T_map_first = made.graph.by_session[found.session].T_odom_submap[0]
        assert np.allclose(answer.T_map_submap[found.session][0], T_map_first, atol=1e-9)
        error = se3.log(se3.inverse(found.T_world_map) @ T_world_first @ se3.inverse(T_map_first))
        distances.append(error @ np.linalg.solve(found.covariance, error))
    assert 2.0 < np.mean(distances) < 12.0  # of six degrees of freedom


def test_derivatives_are_those_of_the_errors() -> None:
    rng = np.random.default_rng(9)
    poses = se3_rows.exp(rng.normal(size=(4, 6)))
    rows, count = np.array([0, 2, 2, 3, 1]), 5
    roots = rng.normal(size=(count, 6, 6))
    directions = rng.normal(size=(2, count, 3))
    places = rng.normal(size=(2, count, 3))
    absolute = AbsoluteEdges(rows, *places, *directions, rng.normal(size=count), roots @ roots.transpose(0, 2, 1))
    edges = Edges.of_motions([(0, 1), (1, 2), (2, 3)], np.tile(np.eye(4), (3, 1, 1)), np.tile(np.eye(6), (3, 1, 1)))
    terms = GroundedEdges(edges, absolute)
    gradient = terms.linearised(poses, terms.errors(poses), np.ones(len(terms))).gradient
    for row in range(4):
        for axis in range(6):
            step = np.zeros((4, 6))
            step[row, axis] = 1e-6
            ahead, behind = (terms.squared_errors(poses @ se3_rows.exp(sign * step)).sum() for sign in (1.0, -1.0))
            assert (ahead - behind) / 4e-6 == pytest.approx(gradient[row, axis], rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(
    "change",
    [{"node": Node("s0", 80)}, {"place_world": np.array([0.0, np.nan, 0.0])}, {"covariance": -np.eye(3)}],
)
def test_a_broken_anchor_is_refused(change: dict[str, object]) -> None:
    made = fleet(3, 0.0)
    broken = replace(fixes(made, 0, 1.0)[0], **change)  # type: ignore[arg-type]
    with pytest.raises(BadField, match="anchor"):
        optimise(made.graph, anchors=[broken])
