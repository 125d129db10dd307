"""A session that states how far its odometry drifts is weighed by that."""

from __future__ import annotations

import functools
import itertools

import numpy as np
import pytest

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import ODOMETRY_CLASSES, LoopEdge, Node, OdometryModel, PoseGraph, Trajectory
from revisit.core.pose_graph.optimisation import OptimisedGraph, optimise

STEP_M, SUBMAPS, EVERY = 5.0, 40, 13
LOOP_COVARIANCE = np.diag([0.05**2] * 3 + [0.005**2] * 3)
WHEEL, LIDAR = OdometryModel.stated("WHEEL"), OdometryModel.stated("LIDAR_INERTIAL")


def test_figures_are_the_standard_deviations_of_a_step():
    model = OdometryModel.stated("0.03 m/m 0.1 deg/m")
    (covariance,) = model.covariances(np.array([10.0]))
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.3] * 3 + [np.radians(1.0)] * 3)


def test_a_class_is_figures():
    for name, (translation, rotation_deg) in ODOMETRY_CLASSES.items():
        assert OdometryModel.stated(name) == OdometryModel.stated(f"{translation} m/m {rotation_deg} deg/m")


def test_nothing_said_is_the_default():
    assert OdometryModel.stated(None) == OdometryModel()


@pytest.mark.parametrize(
    "bad", ["", "wheel", "0.03", "0.03 m/m", "-1 m/m 0.1 deg/m", "0 m/m 0.1 deg/m", "9 m/m 1 deg/m"]
)
def test_anything_else_is_refused(bad):
    with pytest.raises(BadField, match="drift"):
        OdometryModel.stated(bad)


def way() -> np.ndarray:
    """T_world_submap (n, 4, 4) along a road with bends."""
    turns = [se3.from_yaw(0.1 * np.sin(k / 7.0), (STEP_M, 0.0, 0.0)) for k in range(SUBMAPS - 1)]
    return np.stack(list(itertools.accumulate(turns, np.matmul, initial=np.eye(4))))


def noise(covariance: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return se3.exp(rng.normal(size=6) * np.sqrt(np.diag(covariance)))


@functools.cache
def two_robots(seed: int, *, stated: bool) -> tuple[np.ndarray, OptimisedGraph]:
    """One with wheels and one with a LiDAR on one road, a loop at every thirteenth submap. Simulated."""
    rng, poses, tracks = np.random.default_rng(seed), way(), []
    for name, model in (("lidar", LIDAR), ("wheel", WHEEL)):
        covariances = model.covariances(np.full(SUBMAPS - 1, STEP_M))
        driven = [poses[0]]
        for (first, second), covariance in zip(itertools.pairwise(poses), covariances, strict=True):
            driven.append(driven[-1] @ se3.inverse(first) @ second @ noise(covariance, rng))
        tracks.append(Trajectory.from_odometry(name, np.stack(driven), model if stated else OdometryModel()))
    loops = [
        LoopEdge(f"{k}", Node("lidar", k), Node("wheel", k), noise(LOOP_COVARIANCE, rng), LOOP_COVARIANCE)
        for k in range(0, SUBMAPS, EVERY)
    ]
    return poses, optimise(PoseGraph.of(tracks, loops, ("lidar",)))


def normalised_errors(session: str, *, stated: bool, pairs: int = 40) -> np.ndarray:
    """Squared errors (s, n), in variances, of some poses of a session, of pairs of drives: 6 on average if right."""
    found = []
    for seed in range(pairs):
        poses, answer = two_robots(seed, stated=stated)
        at = [7, 20, 33]
        errors = np.stack([se3.log(se3.inverse(poses[k]) @ answer.T_map_submap[session][k]) for k in at])
        covariances = answer.covariances[session][at]
        found.append(np.einsum("ni,ni->n", errors, np.linalg.solve(covariances, errors[..., None])[..., 0]))
    return np.stack(found)


@pytest.mark.parametrize("session", ["lidar", "wheel"])
def test_both_of_a_wheel_and_a_lidar_robot_in_one_map_state_their_errors_rightly(session):
    errors = normalised_errors(session, stated=True)
    assert errors.mean() == pytest.approx(6.0, abs=1.2)
    assert (errors < 12.6).mean() > 0.88  # 95 % of chi-square with 6 degrees of freedom


def test_without_a_statement_wheels_are_believed_too_much():
    assert normalised_errors("wheel", stated=False, pairs=20).mean() > 12.0


def test_the_better_odometry_decides_where_no_loop_is():
    def worst_m(stated: bool) -> float:
        apart = []
        for seed in range(20):
            poses, answer = two_robots(seed, stated=stated)
            gaps = answer.T_map_submap["lidar"][:, :3, 3] - poses[:, :3, 3]
            apart.append(np.linalg.norm(gaps, axis=1).max())
        return float(np.mean(apart))

    assert worst_m(True) < 0.7 * worst_m(False)
