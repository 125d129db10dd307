"""Odometry that begins anew in the middle of a session: known by its times, mended before loops are asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pose_graph.faults import FaultKind
from revisit.core.pose_graph.graph import GraphState, LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.jumps import jumps
from revisit.core.pose_graph.optimisation import optimise
from tests.support.made_up_fleet import LOOP_COVARIANCE

SUBMAPS, AT = 40, 20
"""Submaps of a drive, and the one at which its odometry begins anew."""

SECOND = 1_000_000_000


def drive() -> np.ndarray:
    """T_odom_submap (n, 4, 4), 5 m a step, with bends."""
    steps = [se3.from_yaw(0.06 * np.sin(k / 9.0), (5.0, 0.0, 0.0)) for k in range(SUBMAPS - 1)]
    poses = [se3.from_yaw(0.4, (30.0, 40.0, 0.0))]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.stack(poses)


def began_anew(poses: np.ndarray) -> np.ndarray:
    """The same from its origin on, behind AT."""
    return np.concatenate([poses[:AT], se3.inverse(poses[AT]) @ poses[AT:]])


def times(seconds: float = 5.0) -> np.ndarray:
    return np.arange(SUBMAPS) * round(seconds * SECOND)


def test_a_step_back_to_the_origin_is_a_jump():
    assert jumps(drive(), times()) == ()
    assert jumps(began_anew(drive()), times()) == (AT - 1,)


@pytest.mark.parametrize("paused_s", [60.0, 100.0])
def test_a_robot_that_drove_on_while_its_scans_paused_has_not_jumped(paused_s):
    poses, stamps = drive(), times()
    poses[AT:, :3, 3] += np.array([80.0, 30.0, 0.0])
    stamps[AT:] += round(paused_s * SECOND)
    assert jumps(poses, stamps) == ()


def test_a_robot_that_stops_often_and_one_whose_times_are_not_known_have_not_jumped():
    poses, stamps = drive(), times()
    stamps += 60 * SECOND * np.cumsum(np.arange(SUBMAPS) % 4 != 0)
    assert jumps(poses, stamps) == ()
    assert jumps(began_anew(poses), np.zeros(SUBMAPS, np.int64)) == ()
    assert jumps(poses[:3], stamps[:3]) == ()


@pytest.mark.parametrize(("stop_s", "way_m", "way_s"), [(60.0, 100.0, 67.0), (60.0, 40.0, 40.0), (110.0, 60.0, 40.0)])
def test_a_way_without_stops_of_a_robot_that_works_from_stop_to_stop_is_no_jump(stop_s, way_m, way_s):
    """5 m in 5 s and a stop; then a way at 1 to 1.5 m/s on which no scan came."""
    poses, stamps = drive(), times(5.0 + stop_s)
    poses[AT:, :3, 3] += se3.from_yaw(0.4)[:3, :3] @ (way_m - 5.0, 0.0, 0.0)
    stamps[AT:] += round((way_s - 5.0 - stop_s) * SECOND)
    assert jumps(poses, stamps) == ()


def test_a_car_in_a_jam_that_has_driven_as_fast_before_has_not_jumped():
    """5 m in 0.4 s, then in 5 s; 100 m in 10 s in between, without scans."""
    poses, stamps = drive(), np.cumsum(np.where(np.arange(SUBMAPS) < 10, 0.4, 5.0) * SECOND).astype(np.int64)
    poses[AT:, :3, 3] += se3.from_yaw(0.4)[:3, :3] @ (95.0, 0.0, 0.0)
    stamps[AT:] += 5 * SECOND
    assert jumps(poses, stamps) == ()


@pytest.mark.parametrize(("way_m", "way_s"), [(30.0, 5.0), (100.0, 10.0)])
@pytest.mark.parametrize("bend_deg", [0.0, 25.0])
def test_a_car_that_goes_fast_for_once_without_scans_has_not_jumped(way_m, way_s, bend_deg):
    """5 m in 5 s, but for a way at 6 to 10 m/s on which it drives on, along a bend perhaps; no scan came there."""
    poses, stamps = drive(), times()
    chord, half = np.array([way_m, 0.0, 0.0]), se3.from_yaw(np.radians(bend_deg / 2.0))
    motion = half @ se3.from_rotation_translation(np.eye(3), chord) @ half
    poses[AT:] = poses[AT - 1] @ motion @ se3.inverse(poses[AT]) @ poses[AT:]
    stamps[AT:] += round((way_s - 5.0) * SECOND)
    assert jumps(poses, stamps) == ()
    sideways = poses[AT - 1] @ se3.from_yaw(np.radians(80.0)) @ se3.inverse(poses[AT - 1])
    poses[AT:] = sideways @ poses[AT:]
    assert jumps(poses, stamps) == (AT - 1,)


def test_a_drive_that_begins_anew_keeps_its_loops_and_its_place_and_is_told():
    first, second = drive(), began_anew(drive())
    tracks = [
        Trajectory.from_odometry("a", first),
        replace(Trajectory.from_odometry("b", second), jumps=jumps(second, times())),
    ]
    right = [LoopEdge(f"{k:02d}", Node("a", k), Node("b", k), np.eye(4), LOOP_COVARIANCE) for k in range(SUBMAPS)]
    answer = optimise(PoseGraph.of(tracks, right))
    (fault,) = answer.faults
    assert (fault.session, fault.kind, fault.first, fault.last, fault.loops) == ("b", FaultKind.JUMP, AT - 1, AT, 0)
    assert not fault.undecided
    assert set(answer.loops) == {GraphState.IN_MAP}
    assert np.abs(answer.T_map_submap["a"] - answer.T_map_submap["b"]).max() < 0.05
    T_map_odom = answer.T_map_odom(tracks[1])
    assert np.abs(T_map_odom @ second[-1] - first[-1]).max() < 0.05


def test_a_drive_that_begins_anew_after_it_has_turned_round_is_placed_too():
    """The way back, 0.5 m beside the way there."""
    there = drive()[:AT]
    back = np.stack([one @ se3.from_yaw(np.pi, (0.0, 0.5, 0.0)) for one in there[::-1]])
    odometry = np.concatenate([there, se3.inverse(back[0]) @ back])
    track = replace(Trajectory.from_odometry("a", odometry), jumps=jumps(odometry, times()))
    truth = np.concatenate([there, back])
    right = [
        LoopEdge(f"{k:02d}", Node("a", k), Node("a", j), se3.inverse(truth[k]) @ truth[j], LOOP_COVARIANCE)
        for k in range(AT - 5)
        for j in (SUBMAPS - 1 - k,)
    ]
    answer = optimise(PoseGraph.of([track], right))
    assert [one.kind for one in answer.faults] == [FaultKind.JUMP]
    assert set(answer.loops) == {GraphState.IN_MAP}
    assert np.abs(answer.T_map_submap["a"] - truth).max() < 0.1
