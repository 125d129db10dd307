"""The g2o files that we write, read and optimised by code that shares nothing with the product.

The residuals are those of the format's own definition: t and the vector part of the quaternion of Z^-1 Xi^-1 Xj,
weighed by the information matrix; the optimiser is SciPy's.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

from revisit.core.geometry import se3
from revisit.core.pose_graph.g2o import write_g2o
from revisit.core.pose_graph.graph import LoopEdge, Node, PoseGraph, Trajectory
from revisit.core.pose_graph.optimisation import Robustness, optimise


@pytest.mark.slow
def test_an_independent_optimiser_finds_the_same_poses_in_a_written_graph() -> None:
    graph = _graph()
    ours = optimise(graph, Robustness.PLAIN).T_map_submap
    text = write_g2o(graph, {one.session: one.T_odom_submap for one in graph.trajectories})

    positions = _optimised(text)

    ours_in_order = np.concatenate([ours[one.session][:, :3, 3] for one in graph.trajectories])
    start = np.concatenate([one.T_odom_submap[:, :3, 3] for one in graph.trajectories])
    assert np.abs(start - ours_in_order).max() > 0.5
    np.testing.assert_allclose(positions, ours_in_order, atol=5e-3)


def test_the_optimised_graph_of_an_export_is_at_rest_for_an_independent_optimiser() -> None:
    graph = _graph()
    ours = optimise(graph, Robustness.PLAIN).T_map_submap
    positions = _optimised(write_g2o(graph, ours))
    written = np.concatenate([ours[one.session][:, :3, 3] for one in graph.trajectories])
    np.testing.assert_allclose(positions, written, atol=5e-3)


def _graph() -> PoseGraph:
    """A session of 24 submaps, twice around a circle, with drift, loops and full covariances."""
    rng = np.random.default_rng(0)
    angles = np.linspace(0.0, 4.0 * np.pi, 24, endpoint=False)
    truth = np.stack([se3.from_yaw(a + np.pi / 2, (20 * np.cos(a), 20 * np.sin(a), np.sin(a))) for a in angles])
    poses = [truth[0]]
    for n in range(23):
        poses.append(poses[-1] @ se3.inverse(truth[n]) @ truth[n + 1] @ se3.exp(rng.normal(size=6) * 0.02))
    trajectory = Trajectory.from_odometry("s", np.stack(poses))
    loops = []
    for n in range(0, 12, 2):
        mixed = rng.normal(size=(6, 6)) * 0.01
        T = se3.inverse(truth[n]) @ truth[n + 12] @ se3.exp(rng.normal(size=6) * 0.005)
        loops.append(LoopEdge(f"l{n}", Node("s", n), Node("s", n + 12), T, mixed @ mixed.T + np.eye(6) * 1e-4))
    return PoseGraph.of([trajectory], loops)


def _optimised(text: str) -> np.ndarray:
    """Positions (n, 3) of the vertices after minimising the graph in a g2o file."""
    vertices, edges, fixed = _parsed(text)
    free = [key for key in sorted(vertices) if key not in fixed]
    column = {key: 6 * n for n, key in enumerate(free)}

    def pose(key: int, state: np.ndarray) -> tuple[np.ndarray, Rotation]:
        position, rotation = vertices[key]
        if key in fixed:
            return position, rotation
        moved = state[column[key] : column[key] + 6]
        return position + moved[:3], rotation * Rotation.from_rotvec(moved[3:])

    def residuals(state: np.ndarray) -> np.ndarray:
        parts = []
        for first, second, (shift, turn), root in edges:
            (p, r), (q, s) = pose(first, state), pose(second, state)
            error_turn = turn.inv() * r.inv() * s
            error_shift = turn.inv().apply(r.inv().apply(q - p) - shift)
            quaternion = error_turn.as_quat()
            vector = quaternion[:3] * np.sign(quaternion[3])
            parts.append(root @ np.concatenate([error_shift, vector]))
        return np.concatenate(parts)

    pattern = lil_matrix((6 * len(edges), 6 * len(free)), dtype=int)
    for row, (first, second, _, _) in enumerate(edges):
        for key in (first, second):
            if key not in fixed:
                pattern[6 * row : 6 * row + 6, column[key] : column[key] + 6] = 1
    found = least_squares(residuals, np.zeros(6 * len(free)), jac_sparsity=pattern, x_scale="jac", max_nfev=60)
    return np.stack([pose(key, found.x)[0] for key in sorted(vertices)])


def _parsed(text: str) -> tuple[dict, list, set]:  # type: ignore[type-arg]
    vertices, edges, fixed = {}, [], set()
    for line in text.splitlines():
        kind, *words = line.split()
        numbers = [float(word) for word in words]
        if kind == "VERTEX_SE3:QUAT":
            vertices[int(words[0])] = (np.array(numbers[1:4]), Rotation.from_quat(numbers[4:8]))
        elif kind == "FIX":
            fixed.add(int(words[0]))
        else:
            assert kind == "EDGE_SE3:QUAT"
            information = np.zeros((6, 6))
            information[np.triu_indices(6)] = numbers[9:30]
            information = information + np.triu(information, 1).T
            measured = np.array(numbers[2:5]), Rotation.from_quat(numbers[5:9])
            edges.append((int(words[0]), int(words[1]), measured, np.linalg.cholesky(information).T))
    return vertices, edges, fixed
