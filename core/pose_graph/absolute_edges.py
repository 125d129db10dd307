"""Terms of least squares that tie poses to the world: places of points, and directions, beside edges between poses.

They have the form of `normal_equations.Edges`, so that one solver takes both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3_rows
from revisit.core.kernels.block_cholesky import SIDE
from revisit.core.kernels.pose_edges import summed
from revisit.core.pose_graph.normal_equations import Edges, Equations, Rows

Array64 = NDArray[np.float64]


@dataclass(frozen=True)
class AbsoluteEdges:
    """Measurements of poses in a level world, one row each: of the pose in row `rows` (k,).

    points (k, 3) of its frame lie at `places` (k, 3) of the world; directions `ups` (k, 3) of its frame point upwards;
    directions `forwards` (k, 3) have `headings` (k,), counter-clockwise from east, radians. information (k, 6, 6) of
    the errors (x, y, z, east, north, heading): of the place in metres, of the upward direction as the east and north
    of its unit vector, and of the heading in radians. Zero where nothing was measured.
    """

    rows: Rows
    points: Array64
    places: Array64
    ups: Array64
    forwards: Array64
    headings: Array64
    information: Array64

    def __len__(self) -> int:
        return len(self.rows)

    def joined(self, other: AbsoluteEdges) -> AbsoluteEdges:
        """These, and others after them."""
        return AbsoluteEdges(*(np.concatenate(both) for both in zip(self._parts, other._parts, strict=True)))

    def chosen(self, which: NDArray[np.bool_] | Rows) -> AbsoluteEdges:
        """Some of them."""
        return AbsoluteEdges(*(part[which] for part in self._parts))

    def weighted(self, weights: Array64) -> AbsoluteEdges:
        """The same with their information times `weights` (k,)."""
        return replace(self, information=self.information * weights[:, None, None])

    def points_at(self, poses: Array64) -> Array64:
        """Where poses (n, 4, 4) put the points (k, 3)."""
        at = poses[self.rows]
        return np.asarray(se3_rows.turn(at[:, :3, :3], self.points) + at[:, :3, 3])

    def headings_at(self, poses: Array64) -> Array64:
        """The headings (k,) that poses (n, 4, 4) give the forward directions."""
        ahead = se3_rows.turn(poses[self.rows, :3, :3], self.forwards)
        return np.asarray(np.arctan2(ahead[:, 1], ahead[:, 0]))

    def errors(self, poses: Array64) -> Array64:
        """The errors (k, 6) of poses (n, 4, 4)."""
        up = se3_rows.turn(poses[self.rows, :3, :3], self.ups)
        turned = self.headings_at(poses) - self.headings
        wrapped = np.arctan2(np.sin(turned), np.cos(turned))
        return np.column_stack([self.points_at(poses) - self.places, up[:, :2], wrapped])

    def squared_errors(self, poses: Array64) -> Array64:
        """Squared Mahalanobis distances (k,) of poses (n, 4, 4)."""
        errors = self.errors(poses)
        return np.asarray(np.einsum("ki,kij,kj->k", errors, self.information, errors))

    def jacobians(self, poses: Array64) -> Array64:
        """The derivatives (k, 6, 6) of the errors by tangents of the poses (n, 4, 4)."""
        turns, found = poses[self.rows, :3, :3], np.zeros((len(self), SIDE, SIDE))
        found[:, :3, :3] = turns
        found[:, :3, 3:] = -turns @ se3_rows.hat(self.points)
        found[:, 3:5, 3:] = -(turns @ se3_rows.hat(self.ups))[:, :2]
        ahead, moved = se3_rows.turn(turns, self.forwards), -turns @ se3_rows.hat(self.forwards)
        x, y = ahead[:, :1], ahead[:, 1:2]
        found[:, 5, 3:] = (x * moved[:, 1] - y * moved[:, 0]) / np.maximum(x**2 + y**2, 1e-12)
        return found

    @property
    def _parts(self) -> tuple[NDArray[Any], ...]:
        return self.rows, self.points, self.places, self.ups, self.forwards, self.headings, self.information


@dataclass(frozen=True)
class GroundedEdges:
    """Edges between poses, and after them absolute ones."""

    edges: Edges
    absolute: AbsoluteEdges

    def __len__(self) -> int:
        return len(self.edges) + len(self.absolute)

    def chosen(self, which: NDArray[np.bool_] | Rows) -> GroundedEdges:
        """Some of them, in their order."""
        rows = np.flatnonzero(which) if which.dtype == np.bool_ else np.asarray(which, dtype=np.int64)
        count = len(self.edges)
        return GroundedEdges(self.edges.chosen(rows[rows < count]), self.absolute.chosen(rows[rows >= count] - count))

    def weighted(self, weights: Array64) -> GroundedEdges:
        """The same with their information times weights (e + k,)."""
        count = len(self.edges)
        return GroundedEdges(self.edges.weighted(weights[:count]), self.absolute.weighted(weights[count:]))

    def surer(self, factors: Array64) -> GroundedEdges:
        """The same with the standard deviations of the first s of them, edges, times `factors` (s, 6)."""
        return replace(self, edges=self.edges.surer(factors))

    def errors(self, poses: Array64) -> Array64:
        """The errors (e + k, 6) of poses (n, 4, 4)."""
        return np.concatenate([self.edges.errors(poses), self.absolute.errors(poses)])

    def squared_errors(self, poses: Array64) -> Array64:
        """Squared Mahalanobis distances (e + k,) of poses (n, 4, 4)."""
        return self.squared(self.errors(poses))

    def squared(self, errors: Array64) -> Array64:
        """Squared Mahalanobis distances (e + k,) of errors (e + k, 6)."""
        information = np.concatenate([self.edges.information, self.absolute.information])
        return np.asarray(np.einsum("ei,eij,ej->e", errors, information, errors))

    def linearised(self, poses: Array64, errors: Array64, weights: Array64) -> Equations:
        """The normal equations at the poses (n, 4, 4), in tangents of the poses; see `Edges.linearised`."""
        count = len(self.edges)
        between = self.edges.linearised(poses, errors[:count], weights[:count])
        turned = self.absolute.jacobians(poses)
        pulled = turned.transpose(0, 2, 1) @ (self.absolute.information * weights[count:, None, None])
        force = np.einsum("kij,kj->ki", pulled, errors[count:])
        return replace(
            between,
            diagonal=between.diagonal + summed(pulled @ turned, self.absolute.rows, len(poses)),
            gradient=between.gradient + summed(force, self.absolute.rows, len(poses)),
        )
