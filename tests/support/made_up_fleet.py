"""A made-up fleet on one closed road: drives with drift and unknown starts, right loops and wrong ones. Simulated."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import LoopEdge, Node, OdometryModel, PoseGraph, Trajectory

MODEL = OdometryModel()
LOOP_COVARIANCE = np.diag([0.05**2] * 3 + [0.003**2] * 3)


@dataclass(frozen=True)
class Fleet:
    """A made-up fleet on one closed road: its graph, and the true poses of its submaps in the world."""

    graph: PoseGraph
    truth: dict[str, np.ndarray]

    def error_m(self, T_map_submap: dict[str, np.ndarray]) -> float:
        """Root mean square of the position errors after the best rigid alignment, metres."""
        estimated = np.concatenate([T_map_submap[name][:, :3, 3] for name in self.truth])
        true = np.concatenate([poses[:, :3, 3] for poses in self.truth.values()])
        a, b = estimated - estimated.mean(axis=0), true - true.mean(axis=0)
        u, _, vt = np.linalg.svd(a.T @ b)
        rotation = (u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt).T
        return float(np.sqrt(np.mean(np.sum((a @ rotation.T - b) ** 2, axis=1))))


def road(submaps: int, phase: float, direction: int) -> np.ndarray:
    """Poses (n, 4, 4) around a bumpy closed road of 5 m a submap."""
    angle = phase + direction * np.linspace(0.0, 2 * np.pi, submaps, endpoint=False)
    radius = 5.0 * submaps / (2 * np.pi) * (1 + 0.2 * np.sin(3 * angle))
    places = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sin(2 * angle)], axis=1)
    ahead = np.roll(places, -1, axis=0) - places
    return np.stack(
        [se3.from_yaw(np.arctan2(step[1], step[0]), place) for step, place in zip(ahead, places, strict=True)]
    )


def drifted(truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Odometry of a drive: an arbitrary start and the drift that the model states."""
    poses = [se3.from_yaw(rng.uniform(-3, 3), rng.uniform(-500, 500, 3))]
    for first, second in itertools.pairwise(truth):
        step = se3.inverse(first) @ second
        covariance = MODEL.covariances(np.array([np.linalg.norm(step[:3, 3])]))[0]
        poses.append(poses[-1] @ step @ se3.exp(rng.multivariate_normal(np.zeros(6), covariance)))
    return np.stack(poses)


def fleet(seed: int, wrong_share: float, sessions: int = 3, submaps: int = 80, per_pair: int = 20) -> Fleet:
    """Robots that drive the road from other starts, every second one reversed; loops between all pairs of sessions."""
    rng = np.random.default_rng(seed)
    truth = {f"s{n}": road(submaps, rng.uniform(0, 6), -1 if n % 2 else 1) for n in range(sessions)}
    loops: list[LoopEdge] = []
    for (a, true_a), (b, true_b) in itertools.combinations(truth.items(), 2):
        near = np.argwhere(np.linalg.norm(true_a[:, None, :3, 3] - true_b[None, :, :3, 3], axis=2) < 8.0)
        for row, column in rng.permutation(near)[:per_pair]:
            noise = se3.exp(rng.multivariate_normal(np.zeros(6), LOOP_COVARIANCE))
            T = noise @ se3.inverse(true_a[row]) @ true_b[column]
            loops.append(LoopEdge(f"right-{len(loops)}", Node(a, int(row)), Node(b, int(column)), T, LOOP_COVARIANCE))
        for _ in range(round(per_pair * wrong_share / (1 - wrong_share))):
            ends = Node(a, int(rng.integers(submaps))), Node(b, int(rng.integers(submaps)))
            loops.append(LoopEdge(f"wrong-{len(loops)}", *ends, random_motion(rng), LOOP_COVARIANCE))
    trajectories = [Trajectory.from_odometry(name, drifted(poses, rng)) for name, poses in truth.items()]
    return Fleet(PoseGraph.of(trajectories, loops), truth)


def random_motion(rng: np.random.Generator) -> np.ndarray:
    return se3.from_yaw(rng.uniform(-np.pi, np.pi), (*rng.uniform(-5, 5, 2), 0.0))
