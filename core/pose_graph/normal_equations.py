"""Steps and loops between poses as arrays: errors and gradients of all at once, and their equations, factorised.

gtsam does the same for whole optimisations; here a factorisation is kept, and asked again and again for little. That
takes equations that hold while the poses move. So unknowns are tangents of the map (T becomes exp(tangent) T): what
turns a whole stretch has no error in them wherever it lies. In the frames of the submaps, as gtsam has them, a bend of
0.2 m was enough for old equations to lead away from the optimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from revisit.core.geometry import se3_rows

Array64 = NDArray[np.float64]
Rows = NDArray[np.int64]

ANCHOR_INFORMATION = 1e8
"""Of the pose that is held fast: 0.1 mm and 0.1 mrad."""


@dataclass(frozen=True)
class Edges:
    """Measured motions between poses: from pose `first` (e,) to pose `second` (e,), by row.

    T_second_first (e, 4, 4) is the inverse of what was measured; information (e, 6, 6) that of the tangent
    (x, y, z, rx, ry, rz) in the frame of the second pose.
    """

    first: Rows
    second: Rows
    T_second_first: Array64
    information: Array64

    def joined(self, other: Edges) -> Edges:
        """These, and others after them."""
        return Edges(
            np.concatenate([self.first, other.first]),
            np.concatenate([self.second, other.second]),
            np.concatenate([self.T_second_first, other.T_second_first]),
            np.concatenate([self.information, other.information]),
        )

    def cost_and_gradient(self, poses: Array64) -> tuple[float, Array64]:
        """Squared errors in variances, and half their gradient (n, 6) by the tangents of the poses (n, 4, 4).

        To first order in the errors, as Gauss-Newton has it.
        """
        T_second_map = se3_rows.inverse(poses[self.second])
        errors = se3_rows.log(self.T_second_first @ (se3_rows.inverse(poses[self.first]) @ poses[self.second]))
        weighted = np.einsum("eij,ej->ei", self.information, errors)
        pulls = _transposed_adjoint(T_second_map, weighted)
        gradient = _added(pulls, self.second, len(poses)) - _added(pulls, self.first, len(poses))
        return float(np.einsum("ei,ei->", errors, weighted)), gradient

    def hessian(self, poses: Array64) -> sparse.csc_matrix:
        """The matrix (6 n, 6 n) of the normal equations at the poses (n, 4, 4), singular without an anchor."""
        turn = se3_rows.adjoint(se3_rows.inverse(poses[self.second]))
        weights = turn.transpose(0, 2, 1) @ self.information @ turn
        blocks = np.concatenate([weights, weights, -weights, -weights])
        rows = np.concatenate([self.second, self.first, self.first, self.second])
        columns = np.concatenate([self.second, self.first, self.second, self.first])
        inner = np.arange(6)
        i = np.broadcast_to(6 * rows[:, None, None] + inner[:, None], blocks.shape)
        j = np.broadcast_to(6 * columns[:, None, None] + inner, blocks.shape)
        size = 6 * len(poses)
        return sparse.csc_matrix((blocks.ravel(), (i.ravel(), j.ravel())), shape=(size, size))


def _transposed_adjoint(transforms: Array64, vectors: Array64) -> Array64:
    """Ad^T @ vectors (e, 6) of transforms (e, 4, 4)."""
    turns, force = transforms[:, :3, :3], vectors[:, :3]
    torque = vectors[:, 3:] - np.cross(transforms[:, :3, 3], force)
    return np.concatenate([np.einsum("eji,ej->ei", turns, force), np.einsum("eji,ej->ei", turns, torque)], axis=1)


def _added(vectors: Array64, rows: Rows, count: int) -> Array64:
    """Sums (count, 6) of vectors (e, 6) by row."""
    ones, at = np.ones(len(rows)), np.arange(len(rows))
    return np.asarray(sparse.csr_matrix((ones, (rows, at)), shape=(count, len(rows))) @ vectors)


class Factorisation:
    """The normal equations at some poses, factorised: what any right side would move."""

    def __init__(self, edges: Edges, poses: Array64, anchor: int) -> None:
        """`anchor` is the row of the pose that is held fast. Raises RuntimeError where a pose hangs on nothing."""
        held = np.zeros(6 * len(poses))
        held[6 * anchor : 6 * anchor + 6] = ANCHOR_INFORMATION
        matrix = (edges.hessian(poses) + sparse.diags(held)).tocsc()
        options = {"SymmetricMode": True}  # positive definite: pivots stay on the diagonal
        self._factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)

    def solve(self, right: Array64) -> Array64:
        """The tangents (6 n,) or (6 n, k) of `right`, of the same shape."""
        return np.asarray(self._factors.solve(right))
