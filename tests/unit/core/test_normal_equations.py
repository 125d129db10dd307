"""Derivatives, factors and covariances of pose graphs are those of their plain forms, and of gtsam."""

from __future__ import annotations

import itertools

import gtsam
import numba
import numpy as np
import pytest

from revisit.core.geometry import se3, se3_rows
from revisit.core.kernels import block_cholesky, pose_edges
from revisit.core.pose_graph import normal_equations
from revisit.core.pose_graph.least_squares import minimise, settled
from revisit.core.pose_graph.normal_equations import Edges, Equations, elimination_order, warm_up

POSES = 60


def made(seed: int, loops: int, parts: int = 1) -> tuple[Edges, np.ndarray]:
    """Chains of poses with loops at random within them, which the poses miss; the parts hang together by one edge."""
    rng = np.random.default_rng(seed)
    poses = se3_rows.exp(rng.normal(size=(POSES, 6)))
    each = POSES // parts
    ends = [(n - 1, n) for n in range(1, POSES) if n % each]
    ends += [(0, n) for n in range(each, POSES, each)]
    while len(ends) < POSES - 1 + loops:
        first, second = rng.integers(POSES, size=2).tolist()
        if first != second:
            ends.append((first, second))
    motions = [se3.inverse(poses[a]) @ poses[b] @ se3.exp(0.2 * rng.normal(size=6)) for a, b in ends]
    roots = rng.normal(size=(len(ends), 6, 6)) * 0.02 + rng.uniform(0.02, 0.2, (len(ends), 1, 6)) * np.eye(6)
    return Edges.of_motions(ends, motions, list(roots @ roots.transpose(0, 2, 1))), poses


def dense(equations: Equations, anchor: int) -> np.ndarray:
    """The matrix (n, 6, n, 6) that a factorisation is of."""
    count = len(equations.diagonal)
    matrix = np.zeros((count, 6, count, 6))
    for row in range(count):
        matrix[row, :, row] += equations.diagonal[row]
    for first, second, link in zip(equations.edges.first, equations.edges.second, equations.links, strict=True):
        matrix[first, :, second] += link
        matrix[second, :, first] += link.T
    matrix[anchor, :, anchor] += 1e8 * np.eye(6)
    return matrix


def dense_factor(factor: block_cholesky.BlockFactor) -> np.ndarray:
    """A factor as a matrix (6 n, 6 n)."""
    structure, numbers = factor
    lower = np.zeros((POSES, 6, POSES, 6))
    for k, (first, behind) in enumerate(itertools.pairwise(structure.groups)):
        panel = numbers[structure.offsets[k] : structure.offsets[k + 1]].reshape(-1, 6, behind - first, 6)
        below = structure.rows[structure.begins[k] : structure.begins[k + 1]]
        lower[[*range(first, behind), *below], :, first:behind] = panel
    return lower.reshape(6 * POSES, -1)


def test_derivatives_are_those_of_the_squared_errors() -> None:
    edges, poses = made(1, 20)
    equations = edges.linearised(poses, edges.errors(poses), np.ones(len(edges)))
    rng = np.random.default_rng(2)
    for _ in range(5):
        way = 1e-5 * rng.normal(size=(POSES, 6))
        ahead, behind = (edges.squared_errors(poses @ se3_rows.exp(sign * way)).sum() for sign in (1.0, -1.0))
        assert 2.0 * np.vdot(equations.gradient, way) == pytest.approx(0.5 * (ahead - behind), rel=1e-5)


@pytest.mark.parametrize("tangent", [0.0, 1e-6, 0.2, 1.0])
def test_the_right_jacobian_is_the_derivative_of_the_logarithm(tangent: float) -> None:
    at = tangent * np.random.default_rng(3).normal(size=(1, 6))
    small = 1e-6 * np.eye(6)
    ahead, behind = (se3_rows.log(se3_rows.exp(at) @ se3_rows.exp(sign * small)) for sign in (1.0, -1.0))
    derivative = (ahead - behind).T / 2e-6
    np.testing.assert_allclose(se3_rows.inverse_right_jacobian(at)[0], derivative, atol=1e-3 if tangent > 0.5 else 1e-7)


def test_half_a_turn_has_an_axis() -> None:
    for axis in np.eye(3):
        for angle in (np.pi, np.pi - 1e-9, 3.13):
            turn = se3.exp(np.concatenate([[1.0, 2.0, 3.0], angle * axis]))
            found = se3_rows.log(turn[None])[0]
            assert np.linalg.norm(found[3:]) == pytest.approx(angle, abs=1e-9)
            np.testing.assert_allclose(se3.exp(found), turn, atol=1e-7)


@pytest.mark.parametrize(("seed", "loops", "parts"), [(1, 0, 1), (2, 3, 1), (3, 40, 1), (4, 300, 1), (5, 30, 3)])
def test_a_factorisation_solves_as_the_dense_matrix_does(seed: int, loops: int, parts: int) -> None:
    edges, poses = made(seed, loops, parts)
    equations = edges.linearised(poses, edges.errors(poses), np.ones(len(edges)))
    factorisation = equations.factorised(7)
    matrix = dense(equations, 7).reshape(6 * POSES, -1)
    for right in np.random.default_rng(6).normal(size=(2, 6 * POSES, 3)):
        np.testing.assert_allclose(matrix @ factorisation.solve(right), right, atol=1e-5)
        np.testing.assert_allclose(factorisation.solve(right[:, 0]), factorisation.solve(right)[:, 0], rtol=1e-9)
    inverse = np.linalg.inv(matrix).reshape(POSES, 6, POSES, 6)
    blocks = [inverse[row, :, row] for row in range(POSES)]
    across, own = factorisation.covariances_with_edges(len(edges))
    np.testing.assert_allclose(own, blocks, rtol=1e-5, atol=1e-7)
    of_edges = [inverse[a, :, b] for a, b in zip(edges.first, edges.second, strict=True)]
    np.testing.assert_allclose(across, of_edges, rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(equations.factorised(7).covariances(), own)


@pytest.mark.parametrize(("seed", "loops", "parts"), [(1, 0, 1), (3, 40, 1), (4, 300, 1), (5, 30, 3)])
def test_halves_of_solutions_are_parts_of_whole_ones(seed: int, loops: int, parts: int) -> None:
    edges, poses = made(seed, loops, parts)
    factorisation = edges.in_the_map(poses).factorised(7)
    rng = np.random.default_rng(seed)
    rows, others = ({int(n): rng.normal(size=(6, 6)) for n in rng.choice(POSES, 2, False)} for _ in range(2))
    right, of_others = np.zeros((2, POSES, 6, 6))
    for blocks, filled in ((rows, right), (others, of_others)):
        for row, block in blocks.items():
            filled[row] = block
    moved, pull = factorisation.solve(right.reshape(-1, 6)), rng.normal(size=(POSES, 6))
    one, other = factorisation.half_at(rows), factorisation.half_at(others)
    close = {"rtol": 1e-9, "atol": 1e-9 * float(np.abs(moved).max())}
    np.testing.assert_allclose(one.product(other), moved.T @ of_others.reshape(-1, 6), **close)
    half = factorisation.half(pull)
    np.testing.assert_allclose(one.times(half), moved.T @ pull.ravel(), **close)
    one.add_to(half, np.arange(6.0))
    expected = factorisation.solve(pull) + (moved @ np.arange(6.0)).reshape(-1, 6)
    np.testing.assert_allclose(factorisation.whole(half), expected, **close)


def test_a_half_of_two_poses_has_numbers_only_where_these_are_counted_on() -> None:
    edges, poses = made(1, 0)
    half = edges.in_the_map(poses).factorised(7).half_at({20: np.eye(6), 21: np.eye(6)})
    assert 2 <= len(half.places) < POSES and len(half.numbers) == 6 * len(half.places)


def test_errors_and_pulls_are_those_of_the_plain_formulas() -> None:
    edges, poses = made(2, 300)
    turned = np.random.default_rng(0).choice(POSES, 20, False)
    poses[turned] = poses[turned] @ se3.exp([0.0, 0.0, 0.0, 0.6 * np.pi, 0.0, 0.8 * np.pi])  # nearly half round
    missed = edges.T_second_first @ (se3_rows.inverse(poses[edges.first]) @ poses[edges.second])
    errors = edges.errors(poses)
    np.testing.assert_allclose(errors, se3_rows.log(missed), rtol=1e-9, atol=1e-9)
    weighted = np.einsum("eij,ej->ei", edges.information, errors)
    back = se3_rows.adjoint(se3_rows.inverse(poses[edges.second]))
    pulls, gradient = np.einsum("eji,ej->ei", back, weighted), np.zeros((POSES, 6))
    np.add.at(gradient, edges.second, pulls)
    np.add.at(gradient, edges.first, -pulls)
    cost, found = edges.cost_and_gradient(poses)
    assert cost == pytest.approx(edges.squared(errors).sum(), rel=1e-12)
    np.testing.assert_allclose(found, gradient, rtol=1e-9, atol=1e-9 * float(np.abs(gradient).max()))


@pytest.mark.parametrize(("seed", "loops"), [(1, 0), (3, 40)])
def test_the_covariance_of_each_pose_is_that_of_gtsam(seed: int, loops: int) -> None:
    edges, poses = made(seed, loops)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(poses[0]), gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
    rotation_first = np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])
    for row in range(len(edges)):
        motion = gtsam.Pose3(se3.inverse(edges.T_second_first[row]))
        noise = gtsam.noiseModel.Gaussian.Information(edges.information[row][rotation_first])
        factors.add(gtsam.BetweenFactorPose3(int(edges.first[row]), int(edges.second[row]), motion, noise))
    for key, pose in enumerate(poses):
        values.insert(key, gtsam.Pose3(pose))
    expected = gtsam.Marginals(factors, values)
    found = edges.linearised(poses, edges.errors(poses), np.ones(len(edges))).factorised(0).covariances()
    for key in range(POSES):
        np.testing.assert_allclose(found[key][rotation_first], expected.marginalCovariance(key), rtol=1e-3, atol=1e-8)


def test_a_pose_alone_stays_where_it_is_and_is_as_sure_as_it_is_held() -> None:
    alone, pose = Edges.of_motions([], [], []), se3.exp(np.arange(6.0))[None]
    assert np.array_equal(settled(alone, 0, minimise(alone, 0, pose)), pose)
    for equations in (alone.linearised(pose, alone.errors(pose), np.ones(0)), alone.in_the_map(pose)):
        np.testing.assert_allclose(equations.factorised(0).covariances(), [1e-8 * np.eye(6)])


def test_what_is_not_positive_definite_is_refused() -> None:
    edges, poses = made(2, 3)
    equations = edges.weighted(-np.ones(len(edges))).linearised(poses, edges.errors(poses), np.ones(len(edges)))
    with pytest.raises(RuntimeError, match="positive definite"):
        equations.factorised(0)


@pytest.mark.parametrize(("loops", "widest"), [(0, 2), (30, 4), (300, block_cholesky.WIDEST)])
def test_the_factor_times_itself_is_the_matrix(loops: int, widest: int) -> None:
    edges, poses = made(4, loops)
    equations = edges.in_the_map(poses)
    diagonal = equations.diagonal.copy()
    diagonal[0] += 1e8 * np.eye(6)
    structure = block_cholesky.Structure.of(edges.first, edges.second, POSES)
    assert np.diff(structure.groups).max() == widest
    lower = dense_factor(block_cholesky.factorised(structure, equations.links, diagonal))
    np.testing.assert_allclose(lower @ lower.T, dense(equations, 0).reshape(6 * POSES, -1), rtol=1e-10, atol=1e-6)
    np.testing.assert_allclose(lower, np.linalg.cholesky(lower @ lower.T), rtol=1e-6, atol=1e-6)


def test_an_order_of_elimination_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []

    def watched(first: np.ndarray, second: np.ndarray, count: int) -> np.ndarray:
        found.append(count)
        return elimination_order(first, second, count)

    monkeypatch.setattr(normal_equations, "elimination_order", watched)
    edges, poses = made(2, 20)
    settled(edges, 0, minimise(edges, 0, poses))
    assert found == [POSES]


def test_after_the_warmup_nothing_is_compiled() -> None:
    warm_up()
    compiled_code = [*vars(block_cholesky).values(), *vars(pose_edges).values()]
    kernels = [one for one in compiled_code if isinstance(one, numba.core.dispatcher.Dispatcher)]
    compiled = [len(kernel.signatures) for kernel in kernels]
    edges, poses = made(3, 40)
    edges.cost_and_gradient(poses)
    for equations in (edges.linearised(poses, edges.errors(poses), np.ones(len(edges))), edges.in_the_map(poses)):
        factorisation = equations.factorised(3)
        factorisation.solve(np.ones((6 * POSES, 6)))
        factorisation.whole(factorisation.half(np.ones((POSES, 6))))
        factorisation.half_at({4: np.ones((6, 6))})
        factorisation.covariances()
    assert [len(kernel.signatures) for kernel in kernels] == compiled and sum(compiled) > 3
