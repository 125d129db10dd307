"""Odometry that loops show to be better than it states counts for more; a map of good drives is as good. Simulated."""

from __future__ import annotations

import functools
import itertools
import sys
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pose_graph import odometry_weights
from revisit.core.pose_graph.anchors import Anchor, AnchorState
from revisit.core.pose_graph.faults import FaultKind, Mending, OdometryFault, steps_of
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, OdometryModel, PoseGraph, Trajectory
from revisit.core.pose_graph.held_component import HeldComponent
from revisit.core.pose_graph.odometry_weights import BEST, by_weighed_odometry, step_factors
from revisit.core.pose_graph.optimisation import OptimisedGraph, optimise
from revisit.core.pose_graph.warm_start import SolvedComponent

STEP_M, SUBMAPS = 5.0, 60
LOOPS = np.diag([0.05**2] * 3 + [np.radians(0.16) ** 2] * 3)
LEAST_OF_DEFAULT = BEST.translation / OdometryModel().translation, BEST.rotation_rad_per_m / 2e-3


def way() -> np.ndarray:
    """T_world_submap (n, 4, 4) along a road with bends."""
    turns = [se3.from_yaw(0.1 * np.sin(k / 7.0), (STEP_M, 0.0, 0.0)) for k in range(SUBMAPS - 1)]
    return np.stack(list(itertools.accumulate(turns, np.matmul, initial=np.eye(4))))


def driven(drift: OdometryModel | None, turn_deg_per_m: float, rng: np.random.Generator) -> np.ndarray:
    """Odometry of a drive along the way that errs as `drift` says, or not at all, and turns steadily."""
    poses = way()
    variances = np.zeros(6) if drift is None else np.diag(drift.covariances(np.array([STEP_M]))[0])
    found = [poses[0]]
    for first, second in itertools.pairwise(poses):
        error = rng.normal(size=6) * np.sqrt(variances) + np.radians(turn_deg_per_m) * STEP_M * np.eye(6)[5]
        found.append(found[-1] @ se3.inverse(first) @ second @ se3.exp(error))
    return np.stack(found)


@functools.cache
def two_drives(
    seed: int,
    drift: OdometryModel | None = None,
    stated: str | None = None,
    turn_deg_per_m: float = 0.0,
    every: int = 1,
) -> PoseGraph:
    """Two drives along one way, with loops between each submap of the one and three of the other."""
    rng = np.random.default_rng(seed)
    model = OdometryModel.stated(stated)
    tracks = [Trajectory.from_odometry(name, driven(drift, turn_deg_per_m, rng), model) for name in ("a", "b")]
    ends = [(k, m) for k in range(0, SUBMAPS, every) for m in (k - 1, k, k + 1) if 0 <= m < SUBMAPS]
    noise = rng.normal(size=(len(ends), 6)) * np.sqrt(np.diag(LOOPS))
    return PoseGraph.of(tracks, [looped("b", k, m, one) for (k, m), one in zip(ends, noise, strict=True)])


def looped(session: str, first: int, second: int, error: np.ndarray) -> LoopEdge:
    """The loop between a submap of drive a and one of another, with an error."""
    seen = se3.exp(error) @ se3.inverse(way()[first]) @ way()[second]
    return LoopEdge(f"{session}-{first:03d}-{second:03d}", Node("a", first), Node(session, second), seen, LOOPS)


def worst_m(answer: OptimisedGraph) -> float:
    """The farthest that a submap lies from where it belongs, as seen from the first one."""
    return max(float(np.linalg.norm((its - way())[:, :3, 3], axis=1).max()) for its in answer.T_map_submap.values())


def factors_of(graph: PoseGraph, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """The factors (s, 6) by the answer with steps as they state."""
    component = as_stated(graph, monkeypatch)
    return step_factors(component.trajectories, component.edges, 0, component.before)[0]


def without_estimate(patch: pytest.MonkeyPatch) -> None:
    """All steps are as sure as they state."""
    patch.setattr(odometry_weights, "step_factors", lambda *given: (np.ones((1, 6)), given[-1]))


def as_stated(graph: PoseGraph, monkeypatch: pytest.MonkeyPatch) -> HeldComponent:
    """The component by the drift as stated."""
    with monkeypatch.context() as patch:
        without_estimate(patch)
        answer = optimise(graph)
    return HeldComponent.of(graph, answer.loops, answer.T_map_submap, answer.components[0])


def test_a_map_of_drives_without_errors_is_not_bent_by_the_errors_of_loops(monkeypatch):
    by_drift = as_stated(two_drives(0), monkeypatch)
    before = np.abs(by_drift.before.reshape(2, SUBMAPS, 4, 4) - way())[..., :3, 3].max()
    answer = optimise(two_drives(0))
    assert before > 0.5
    assert worst_m(answer) < 0.1
    assert set(answer.loops) == {GraphState.IN_MAP}


def test_steps_that_do_not_err_are_as_sure_as_the_best_odometry(monkeypatch):
    found = factors_of(two_drives(0), monkeypatch)
    assert np.allclose(found, np.repeat(LEAST_OF_DEFAULT, 3))


@pytest.mark.parametrize("share", [0.3, 0.5, 1.0])
def test_the_factor_is_by_how_much_less_odometry_errs_than_it_states(share, monkeypatch):
    stated = OdometryModel()
    less = OdometryModel(share * stated.translation, share * stated.rotation_rad_per_m, 0.0, 0.0)
    monkeypatch.setattr(odometry_weights, "STEADY_WEIGHT", 0.0)
    found = np.mean([factors_of(two_drives(seed, less), monkeypatch)[0, [0, 3]] for seed in range(4)], axis=0)
    assert found == pytest.approx([share, share], rel=0.2)


def test_the_factors_are_where_the_restricted_likelihood_is_greatest(monkeypatch):
    monkeypatch.setattr(odometry_weights, "SPENT", 0.0)
    monkeypatch.setattr(odometry_weights, "WORSE", np.inf)
    monkeypatch.setattr(odometry_weights, "SETTLED", 1e-6)
    monkeypatch.setattr(odometry_weights, "MAX_ROUNDS", 100)
    monkeypatch.setattr(odometry_weights, "STEADY_WEIGHT", 0.0)
    graph = two_drives(3, OdometryModel(0.005, 1e-3, 0.0, 0.0), every=6)
    component = as_stated(graph, monkeypatch)
    steps = 2 * (SUBMAPS - 1)
    found = step_factors(component.trajectories, component.edges, 0, component.before)[0][0, [0, 3]]
    poses = by_weighed_odometry(component.trajectories, component.edges, 0, component.before)

    def minus_twice_log(translation: float, rotation: float) -> float:
        factors = np.tile(np.repeat([translation, rotation], 3), (steps, 1))
        edges = component.edges.surer(factors)
        equations = edges.linearised(poses, edges.errors(poses), np.ones(len(edges)))
        matrix = np.zeros((len(poses), 6, len(poses), 6))
        matrix[np.arange(len(poses)), :, np.arange(len(poses))] = equations.diagonal
        for first, second, link in zip(edges.first, edges.second, equations.links, strict=True):
            matrix[first, :, second] += link
            matrix[second, :, first] += link.T
        matrix = matrix.reshape(6 * len(poses), -1)[6:, 6:]
        gradient = equations.gradient.ravel()[6:]
        least = edges.squared_errors(poses).sum() - gradient @ np.linalg.solve(matrix, gradient)
        return float(least + np.linalg.slogdet(matrix)[1] + 2.0 * np.log(factors).sum())

    best = minus_twice_log(*found)
    assert (found < 0.9).all()
    for change in (0.9, 1.1):
        assert minus_twice_log(found[0] * change, found[1]) > best
        assert minus_twice_log(found[0], found[1] * change) > best


def test_odometry_that_errs_as_it_states_is_left_alone():
    drift = OdometryModel.stated("WHEEL")
    answer = optimise(graph := two_drives(1, drift, "WHEEL"))
    component = HeldComponent.of(graph, answer.loops, answer.T_map_submap, answer.components[0])
    assert (step_factors(component.trajectories, component.edges, 0, component.before)[0] > 0.85).all()


def farthest(poses: np.ndarray) -> float:
    """The largest coordinate by which poses (d, n, 4, 4) of drives along the way are off."""
    return float(np.abs(poses - way())[..., :3, 3].max())


@pytest.mark.parametrize(("drift", "every"), [(OdometryModel(), 3), (OdometryModel.stated("VISUAL"), 6)])
def test_a_worse_drive_among_good_ones_does_not_bend_them(drift, every, monkeypatch):
    """All state the default drift. The worse one is half as long, and is seen less often."""
    graph, rng = two_drives(2), np.random.default_rng(2)
    worse = Trajectory.from_odometry("worse", driven(drift, 0.0, rng)[: SUBMAPS // 2 + 1])
    noise = rng.normal(size=(SUBMAPS, 6)) * np.sqrt(np.diag(LOOPS))
    seen = [looped("worse", k, k, noise[k]) for k in range(0, len(worse), every)]
    among = PoseGraph.of([*graph.trajectories, worse], [*graph.loops, *seen])
    stated = as_stated(among, monkeypatch).before[: 2 * SUBMAPS].reshape(2, SUBMAPS, 4, 4)
    poses = optimise(among).T_map_submap
    assert farthest(np.stack([poses["a"], poses["b"]])) < 0.9 * farthest(stated)
    good, its = np.split(factors_of(among, monkeypatch), [2 * (SUBMAPS - 1)])
    assert (its.mean(axis=0) > 1.2 * good.mean(axis=0))[3:].all()


def test_odometry_that_states_more_than_the_best_is_not_taken_as_better(monkeypatch):
    assert (factors_of(two_drives(0, stated="0.001 m/m 0.002 deg/m"), monkeypatch) == 1.0).all()


def test_a_turn_that_drives_share_is_no_good_odometry(monkeypatch):
    assert (factors_of(two_drives(0, turn_deg_per_m=0.025), monkeypatch) == 1.0).all()


def test_few_loops_change_no_byte(monkeypatch):
    graph = two_drives(0, every=1)
    few = replace(graph, loops=graph.loops[60:62])
    component = as_stated(few, monkeypatch)
    assert by_weighed_odometry(component.trajectories, component.edges, 0, component.before) is component.before


@pytest.mark.parametrize("loops", [0, 2])
def test_loops_that_fit_exactly_change_no_byte_where_they_are_few(loops, monkeypatch):
    graph, poses = two_drives(0), way()
    exact = [replace(one, T_match_query=se3.inverse(poses[one.match.ordinal]) @ poses[one.query.ordinal])
             for one in graph.loops[60 : 60 + loops]]  # fmt: skip
    component = as_stated(replace(graph, loops=tuple(exact)), monkeypatch)
    assert by_weighed_odometry(component.trajectories, component.edges, 0, component.before) is component.before


def test_a_graph_that_states_no_drift_keeps_every_byte(monkeypatch):
    graph = two_drives(0)
    plain = replace(graph, trajectories=tuple(replace(one, odometry=None) for one in graph.trajectories))
    known = as_stated(plain, monkeypatch)
    assert np.concatenate(list(optimise(plain).T_map_submap.values())).tobytes() == known.before.tobytes()


def test_covariances_are_those_by_the_drift_that_is_stated():
    """What drives err by together no loop between them shows."""
    graph = two_drives(0)
    plain = replace(graph, trajectories=tuple(replace(one, odometry=None) for one in graph.trajectories))
    for session, stated in optimise(plain).covariances.items():
        assert np.array_equal(optimise(graph).covariances[session], stated)


def test_a_mended_step_is_as_sure_as_its_mending(monkeypatch):
    graph = two_drives(0)
    fault = OdometryFault("b", FaultKind.SLIP, 30, 32, 1.0, 0.1, 9)
    mended = Mending(fault, steps_of(graph.trajectories[1])[30:32], np.full((2, 6), 0.01)).applied(
        graph.trajectories[1]
    )
    found = factors_of(replace(graph, trajectories=(graph.trajectories[0], mended)), monkeypatch)[SUBMAPS - 1 :]
    assert (found[30:32] == 1.0).all()
    assert (np.delete(found, [30, 31], axis=0) < 1.0).all()


def test_one_loop_more_does_not_bend_the_map_back():
    graph = two_drives(0)
    fewer, last = replace(graph, loops=graph.loops[:-1]), graph.loops[-1]
    poses = optimise(fewer).T_map_submap
    solved = SolvedComponent(fewer, poses, range(len(fewer.loops)), "a")
    assert solved.add(last) is GraphState.IN_MAP
    solved.refresh()
    moved = [solved.T_map_submap(Node("a", n))[:3, 3] - poses["a"][n, :3, 3] for n in range(SUBMAPS)]
    assert np.linalg.norm(moved, axis=1).max() < 0.1


def test_anchors_of_a_good_drive_do_not_bend_it_either():
    graph = two_drives(0)
    world = se3.from_yaw(0.7, (30.0, -20.0, 0.0))
    noise = np.random.default_rng(5).normal(0.0, 0.5, (SUBMAPS, 3))
    anchors = [
        Anchor(f"{k}", Node("a", k), np.zeros(3), (world @ way()[k])[:3, 3] + noise[k], 0.25 * np.eye(3))
        for k in range(0, SUBMAPS, 4)
    ]
    answer = optimise(graph, anchors=anchors)
    assert len(answer.georeferences) == 1
    assert worst_m(answer) < 0.2


def test_anchors_hold_drives_that_share_a_turn_as_small_as_that_of_loops(monkeypatch):
    """Of 0.004 degrees a metre along 600 m, which no loop shows."""
    monkeypatch.setattr(sys.modules[__name__], "SUBMAPS", 120)
    graph, world = two_drives.__wrapped__(0, turn_deg_per_m=0.004), se3.from_yaw(0.7, (30.0, -20.0, 0.0))
    noise = np.random.default_rng(5).normal(0.0, 0.3, (SUBMAPS, 3))
    anchors = [
        Anchor(f"{k}", Node("a", k), np.zeros(3), (world @ way()[k])[:3, 3] + noise[k], 0.3**2 * np.eye(3))
        for k in range(0, SUBMAPS, 8)
    ]

    def off_m(answer: OptimisedGraph) -> float:
        (found,) = answer.georeferences
        poses = found.T_world_map @ np.stack(list(answer.T_map_submap.values()))
        return float(np.linalg.norm((poses - world @ way())[..., :3, 3], axis=-1).max())

    now = off_m(optimise(graph, anchors=anchors))
    without_estimate(monkeypatch)
    assert now < 1.1 * off_m(optimise(graph, anchors=anchors)) < 0.5


def test_anchors_hold_drives_that_share_an_error_of_length_as_before(monkeypatch):
    """Two drives whose odometry is 1 % too long alike."""
    graph, world = two_drives(0), se3.from_yaw(0.7, (30.0, -20.0, 0.0))
    longer_by = np.ones((4, 4))
    longer_by[:3, 3] = 1.01
    poses = {one.session: longer_by * one.T_odom_submap for one in graph.trajectories}
    longer = PoseGraph.of([Trajectory.from_odometry(*one) for one in poses.items()], list(graph.loops))
    anchors = [
        Anchor(f"{k}", Node("a", k), np.zeros(3), (world @ way()[k])[:3, 3], 0.1**2 * np.eye(3))
        for k in range(0, SUBMAPS, 4)
    ]
    answer = optimise(longer, anchors=anchors)
    assert all(one.state is AnchorState.IN_MAP for one in answer.anchors)
    without_estimate(monkeypatch)
    assert all(
        np.array_equal(optimise(longer, anchors=anchors).T_map_submap[k], its) for k, its in answer.T_map_submap.items()
    )
