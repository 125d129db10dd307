"""Steps and loops between poses as arrays: errors and derivatives of all at once, and their equations, factorised.

For a whole optimisation the unknowns are tangents of the poses (T becomes T exp(tangent)): numbers stay small however
large the map is. For a factorisation that is kept and asked again while the poses move they are tangents of the map
(T becomes exp(tangent) T): what turns a whole stretch has no error in them wherever it lies, where in the frames of the
submaps a bend of 0.2 m was enough for old equations to lead away from the optimum.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from revisit.core.geometry import se3, se3_rows
from revisit.core.kernels.block_cholesky import (
    SIDE,
    BlockFactor,
    Structure,
    columns_of,
    complete,
    factorised,
    halve,
    inverse_blocks,
    path,
    solved,
)
from revisit.core.kernels.pose_edges import edge_errors, edge_pulls, summed
from revisit.core.pose_graph.graph import LoopEdge, Node, Trajectory

Array64 = NDArray[np.float64]
Rows = NDArray[np.int64]

ANCHOR_INFORMATION = 1e8
"""Of the pose that is held fast: 0.1 mm and 0.1 mrad."""


@dataclass(frozen=True)
class Edges:
    """Measured motions between poses: from pose `first` (e,) to pose `second` (e,), by row.

    T_second_first (e, 4, 4) is the inverse of the measured motion; information (e, 6, 6) that of the tangent
    (x, y, z, rx, ry, rz) in the frame of the second pose.
    """

    first: Rows
    second: Rows
    T_second_first: Array64
    information: Array64

    @classmethod
    def of_motions(
        cls,
        ends: Sequence[tuple[int, int]],
        motions: Sequence[se3.Matrix4] | Array64,
        covariances: Sequence[Array64] | Array64,
    ) -> Edges:
        """Motions T_first_second between the poses in two rows, with covariances in the frame of the second."""
        rows = np.array(ends, dtype=np.int64).reshape(-1, 2)
        return cls(
            rows[:, 0],
            rows[:, 1],
            se3_rows.inverse(np.reshape(motions, (-1, 4, 4))),
            _information(np.reshape(covariances, (-1, SIDE, SIDE))),
        )

    @classmethod
    def of_steps(cls, trajectories: Iterable[Trajectory], rows: Mapping[Node, int]) -> Edges:
        """The steps between those submaps of some trajectories that have a row: the first ones of each."""
        ends: list[tuple[int, int]] = []
        motions: list[se3.Matrix4] = []
        covariances: list[Array64] = []
        for one in trajectories:
            known = [rows[node] for k in range(len(one)) if (node := Node(one.session, k)) in rows]
            poses = one.T_odom_submap[: len(known)]
            ends += itertools.pairwise(known)
            motions += list(se3_rows.inverse(poses[:-1]) @ poses[1:])
            covariances += list(one.step_covariances[: len(motions) - len(covariances)])
        return cls.of_motions(ends, motions, covariances)

    @classmethod
    def of_loops(cls, loops: Sequence[LoopEdge], rows: Mapping[Node, int]) -> Edges:
        """Some loops, in their order; each has the weight of its independent share."""
        poses = np.reshape([loop.T_match_query for loop in loops], (-1, 4, 4))
        stated = np.reshape([loop.covariance for loop in loops], (-1, SIDE, SIDE))
        shares = np.reshape([loop.independent_share for loop in loops], (-1, 1, 1))
        turn = se3_rows.adjoint(se3_rows.inverse(poses))
        in_query = turn @ (stated / shares) @ turn.transpose(0, 2, 1)
        return cls.of_motions([(rows[loop.match], rows[loop.query]) for loop in loops], poses, in_query)

    def __len__(self) -> int:
        return len(self.first)

    def joined(self, other: Edges) -> Edges:
        """These, and others after them."""
        return Edges(
            np.concatenate([self.first, other.first]),
            np.concatenate([self.second, other.second]),
            np.concatenate([self.T_second_first, other.T_second_first]),
            np.concatenate([self.information, other.information]),
        )

    def chosen(self, which: NDArray[np.bool_] | Rows) -> Edges:
        """Some of them."""
        return Edges(self.first[which], self.second[which], self.T_second_first[which], self.information[which])

    def weighted(self, weights: Array64) -> Edges:
        """The same with their information times `weights` (e,)."""
        return Edges(self.first, self.second, self.T_second_first, self.information * weights[:, None, None])

    def surer(self, factors: Array64) -> Edges:
        """The same with the standard deviations of the first s of them times `factors` (s, 6)."""
        information, some = self.information.copy(), 1.0 / factors
        information[: len(some)] *= some[:, :, None] * some[:, None, :]
        return replace(self, information=information)

    def as_posed(self, poses: Array64) -> Edges:
        """The same with the motions that poses (n, 4, 4) have: these are the most likely ones, as sure as before."""
        return replace(self, T_second_first=se3_rows.inverse(poses[self.second]) @ poses[self.first])

    def elimination(self, count: int) -> Elimination:
        """How `count` poses between which these edges are will be eliminated."""
        return _elimination(self.first.tobytes(), self.second.tobytes(), count)

    def errors(self, poses: Array64) -> Array64:
        """The tangents (e, 6), in the frames of the second poses, by which the poses (n, 4, 4) miss the motions."""
        errors, opposite = edge_errors(self.first, self.second, self.T_second_first, poses)
        if opposite.any():
            seen = se3_rows.inverse(poses[self.first[opposite]]) @ poses[self.second[opposite]]
            errors[opposite] = se3_rows.log(self.T_second_first[opposite] @ seen)
        return errors

    def squared_errors(self, poses: Array64) -> Array64:
        """Squared Mahalanobis distances (e,) of the motions from the poses."""
        return self.squared(self.errors(poses))

    def squared(self, errors: Array64) -> Array64:
        """Squared Mahalanobis distances (e,) of `errors` (e, 6)."""
        return np.asarray(np.einsum("ei,ei->e", errors, np.einsum("eij,ej->ei", self.information, errors)))

    def linearised(self, poses: Array64, errors: Array64, weights: Array64) -> Equations:
        """The normal equations at the poses (n, 4, 4), in tangents of the poses; `errors` (e, 6) are those there, each
        edge counts `weights` (e,).
        """
        T_second_first = se3_rows.inverse(poses[self.second]) @ poses[self.first]
        bends = se3_rows.inverse_right_jacobian(errors)
        pulled = bends.transpose(0, 2, 1) @ (self.information * weights[:, None, None])
        force = np.einsum("eij,ej->ei", pulled, errors)
        of_second = pulled @ bends
        turned = -se3_rows.adjoint(T_second_first)
        links = turned.transpose(0, 2, 1) @ of_second
        of_first = links @ turned
        back = np.einsum("eji,ej->ei", turned, force)
        count = len(poses)
        return Equations(
            self,
            links,
            summed(of_first, self.first, count) + summed(of_second, self.second, count),
            summed(back, self.first, count) + summed(force, self.second, count),
        )

    def cost_and_gradient(self, poses: Array64) -> tuple[float, Array64]:
        """Squared errors in variances, and half their gradient (n, 6) by tangents of the map.

        To first order in the errors, as Gauss-Newton has it.
        """
        return edge_pulls(self.first, self.second, self.information, self.errors(poses), poses)

    def in_the_map(self, poses: Array64) -> Equations:
        """The normal equations at the poses (n, 4, 4), in tangents of the map, of edges without errors."""
        turn = se3_rows.adjoint(se3_rows.inverse(poses[self.second]))
        weights, count = turn.transpose(0, 2, 1) @ self.information @ turn, len(poses)
        diagonal = summed(weights, self.first, count) + summed(weights, self.second, count)
        return Equations(self, -weights, diagonal, np.zeros((count, SIDE)))


@dataclass(frozen=True)
class Equations:
    """Normal equations of poses in blocks of six.

    links (e, 6, 6): of the rows of the first and the columns of the second pose of each of the `edges`; diagonal
    (n, 6, 6); gradient (n, 6), half of that of the squared errors.
    """

    edges: Edges
    links: Array64
    diagonal: Array64
    gradient: Array64

    def factorised(self, anchor: int | None, damping: float = 0.0) -> Factorisation:
        """Their factorisation; the pose in row `anchor`, if any, is held fast, and `damping` is added to the diagonal.

        Raises RuntimeError where a pose hangs on nothing.
        """
        elimination = self.edges.elimination(len(self.diagonal))
        places = elimination.places
        diagonal = np.empty_like(self.diagonal)
        diagonal[places] = self.diagonal + damping * np.eye(SIDE)
        if anchor is not None:
            diagonal[places[anchor]] += ANCHOR_INFORMATION * np.eye(SIDE)
        return Factorisation(places, factorised(elimination.structure, self.links, diagonal))


@dataclass(frozen=True)
class Elimination:
    """The order in which poses are eliminated, and where their factor has numbers then.

    places (n,): of the poses, as eliminated.
    """

    places: Rows
    structure: Structure


@lru_cache(maxsize=4)
def _elimination(first_rows: bytes, second_rows: bytes, count: int) -> Elimination:
    """The last ones are kept: a map is solved many times over, each time with other weights."""
    first, second = (np.frombuffer(rows, dtype=np.int64) for rows in (first_rows, second_rows))
    places = elimination_order(first, second, count)
    return Elimination(places, Structure.of(places[first], places[second], count))


@dataclass(frozen=True)
class Factorisation:
    """Normal equations, factorised, to be solved for any right side. `places` (n,): of the poses, as eliminated."""

    places: Rows
    factor: BlockFactor

    def solve(self, right: Array64) -> Array64:
        """The tangents (6 n,) or (6 n, k) of `right`, of the same shape."""
        ordered = np.empty((len(self.places), SIDE, right.size // (SIDE * len(self.places))))
        ordered[self.places] = right.reshape(ordered.shape)
        return np.asarray(solved(self.factor, ordered)[self.places].reshape(right.shape))

    def half(self, right: Array64) -> Array64:
        """The first half (6 n,) of the solution for `right` (n, 6), in the order of elimination."""
        found = np.empty((len(self.places), SIDE))
        found[self.places] = right
        halve(self.factor, found.reshape(1, -1))
        return found.ravel()

    def half_at(self, blocks: Mapping[int, Array64]) -> Half:
        """The first half of the solution for a right side with blocks (6, k) at some poses, by row, and no others."""
        at = [int(self.places[row]) for row in blocks]
        count = next(iter(blocks.values())).shape[1]
        right = np.zeros((count, len(self.places), SIDE))
        for place, block in zip(at, blocks.values(), strict=True):
            right[:, place] = block.T
        groups = path(self.factor.structure, at)
        halve(self.factor, right.reshape(count, -1), groups)
        places = columns_of(self.factor.structure, groups)
        return Half(places, right[:, places].reshape(count, -1).T)

    def whole(self, half: Array64) -> Array64:
        """The solution (n, 6) of its first half (6 n,)."""
        found = half[None].copy()
        complete(self.factor, found)
        return found.reshape(-1, SIDE)[self.places]

    def covariances(self) -> Array64:
        """The covariance (n, 6, 6) of the tangent of each pose; the factorisation is used up by it."""
        return self.covariances_with_edges(0)[1]

    def covariances_with_edges(self, edges: int) -> tuple[Array64, Array64]:
        """The covariances (edges, 6, 6) of the tangents of the first pose with those of the second, of the first
        `edges` of the equations, and (n, 6, 6) of each pose; the factorisation is used up by it.
        """
        across, own = inverse_blocks(self.factor, edges)
        return across, np.asarray(own[self.places])


@dataclass(frozen=True)
class Half:
    """L^-1 J^T of a factor L and some rows J that few poses count in: what all others follow from.

    places (p,): of the poses with numbers, as eliminated; numbers (6 p, k): those of each of the k rows.
    """

    places: Rows
    numbers: Array64

    def product(self, other: Half) -> Array64:
        """J H^-1 J^T (k, m) of these rows with others, for H = L L^T."""
        _, own, its = np.intersect1d(self.places, other.places, assume_unique=True, return_indices=True)
        return np.asarray(self._at(own).T @ other._at(its))

    def _at(self, which: Rows) -> Array64:
        return self.numbers.reshape(len(self.places), -1)[which].reshape(SIDE * len(which), -1)

    def times(self, half: Array64) -> Array64:
        """J H^-1 g (k,) for the half L^-1 g (6 n,)."""
        return np.asarray(half.reshape(-1, SIDE)[self.places].ravel() @ self.numbers)

    def add_to(self, half: Array64, amounts: Array64) -> None:
        """Add the half for J^T `amounts` (k,) to another one (6 n,)."""
        half.reshape(-1, SIDE)[self.places] += (self.numbers @ amounts).reshape(-1, SIDE)


def elimination_order(first: Rows, second: Rows, count: int) -> Rows:
    """The places (n,) of `count` poses in an order in which few more of them come to depend on each other.

    Of least degree, as SuperLU finds it: of a matrix with one number a pose.
    """
    links = np.concatenate([first, second]), np.concatenate([second, first])
    beside = sparse.csc_matrix((np.full(2 * len(first), -1.0), links), shape=(count, count))
    matrix = (beside + sparse.diags(1.0 - np.asarray(beside.sum(axis=0)).ravel())).tocsc()
    options = {"SymmetricMode": True}  # positive definite: pivots stay on the diagonal
    factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return np.asarray(factors.perm_c, dtype=np.int64)


def warm_up() -> None:
    """Solve two poses, for the compiler's sake alone."""
    poses = np.tile(np.eye(4), (2, 1, 1))
    edges = Edges.of_motions([(0, 1)], [np.eye(4)], [np.eye(SIDE)])
    edges.cost_and_gradient(poses)
    for equations in (edges.linearised(poses, edges.errors(poses), np.ones(1)), edges.in_the_map(poses)):
        factorisation = equations.factorised(0)
        factorisation.solve(np.zeros(2 * SIDE))
        factorisation.covariances()


def _information(covariances: Array64) -> Array64:
    """The inverses (e, 6, 6) of covariances, symmetric to the last digit."""
    found = np.linalg.inv(covariances)
    return np.asarray(0.5 * (found + found.transpose(0, 2, 1)))
