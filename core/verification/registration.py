"""Registration: point-to-plane ICP from coarse to fine, and how well the surfaces fix the pose (decision 0024)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.kernels.surface_alignment import aligned
from revisit.core.verification.oriented_points import OrientedPoints, contact_in_poses

Array64 = NDArray[np.float64]

MIN_COUNTERPARTS = 30
"""An ICP step needs at least so many pairs of points."""

_FACING_ALIKE = 0.5  # smallest cosine between the normals of two counterparts
_ROBUST_SHARE = 0.2  # of the reach: the residual at which a pair weighs a quarter
_DAMPING = 1e-6
_ICP_EDGE_M = 1.5  # of the columns in which counterparts are sought, two for each point


@dataclass(frozen=True)
class Registration:
    """Where ICP ended: T_match_query (4, 4), and whether it was refined or given up after the coarse steps.

    agreement: the share of the few points of the coarse steps that then lay on the other surface; left_out: where the
    other starts were when this one went on alone.
    """

    T_match_query: se3.Matrix4
    refined: bool
    agreement: float = 0.0
    left_out: tuple[se3.Matrix4, ...] = ()


@dataclass(frozen=True)
class Counterparts:
    """Point pairs of one ICP step in the match frame.

    points (k, 3) of the query, their signed distances (k,) to the planes of their counterparts, the normals (k, 3) of
    these planes.
    """

    points: Array64
    residuals: Array64
    normals: Array64


def register(
    starts: Sequence[se3.Matrix4], query: OrientedPoints, match: OrientedPoints, config: VerificationConfig
) -> Registration:
    """Point-to-plane ICP from the best of `starts` (each T_match_query), coarse first and then fine.

    All starts are refined by a few coarse steps on few points; the one on which most of them agree then goes on alone
    (docs/decisions/0024). Where too little of the structure lies on the other surface after the coarse steps, there are
    no fine ones: most candidates are no loops, and fine steps cost time.
    """
    if len(starts) == 1:
        (only,) = _approach(starts, query, match, config, config.coarse_rounds)
        return _refined(only, (), query, match, config)
    approached = _approach(starts, query, match, config, config.first_rounds)
    best = max(range(len(starts)), key=lambda row: approached[row].agreement)
    left_out = tuple(one.T_match_query for row, one in enumerate(approached) if row != best)
    (gone_on,) = _approach([approached[best].T_match_query], query, match, config, _further(config))
    return _refined(gone_on, left_out, query, match, config)


def reconsider(
    registration: Registration, query: OrientedPoints, match: OrientedPoints, config: VerificationConfig
) -> Registration | None:
    """The registration from a start that was left out, where on all coarse steps more points agree on it."""
    gone_on = _approach(registration.left_out, query, match, config, _further(config))
    best = max(gone_on, key=lambda one: one.agreement, default=None)
    if best is None or best.agreement <= registration.agreement:
        return None
    return _refined(best, (), query, match, config)


@dataclass(frozen=True)
class _Approached:
    """A pose after coarse steps, the share of the few points that lie on the other surface, and of those that stand
    in the common region.
    """

    T_match_query: se3.Matrix4
    agreement: float
    overlap: float


def _approach(
    starts: Sequence[se3.Matrix4], query: OrientedPoints, match: OrientedPoints, config: VerificationConfig, rounds: int
) -> list[_Approached]:
    few = query.kept(OrientedPoints.thinned, config.coarse_share)
    poses = iterate_all(starts, few, match, config.coarse_distance, rounds)
    found = contact_in_poses([(pose, few, match) for pose in poses], config)
    count = max(len(few.points), 1)
    return [_Approached(pose, one.touching / count, one.share) for pose, one in zip(poses, found, strict=True)]


def _further(config: VerificationConfig) -> int:
    return max(config.coarse_rounds - config.first_rounds, 0)


def _refined(
    found: _Approached,
    left_out: tuple[se3.Matrix4, ...],
    query: OrientedPoints,
    match: OrientedPoints,
    config: VerificationConfig,
) -> Registration:
    if found.agreement < config.min_agreement or found.overlap < config.min_coarse_overlap * config.min_overlap:
        return Registration(found.T_match_query, False, found.agreement, left_out)
    T_match_query = iterate(found.T_match_query, query, match, config.fine_distance, config.fine_rounds)
    return Registration(T_match_query, True, found.agreement, left_out)


def iterate(
    T_match_query: se3.Matrix4, query: OrientedPoints, match: OrientedPoints, reach: float, rounds: int
) -> se3.Matrix4:
    """Up to `rounds` Gauss-Newton steps from `T_match_query`, with counterparts within `reach` metres."""
    return iterate_all([T_match_query], query, match, reach, rounds)[0]


def iterate_all(
    starts: Sequence[se3.Matrix4], query: OrientedPoints, match: OrientedPoints, reach: float, rounds: int
) -> list[se3.Matrix4]:
    """As `iterate`, from each of `starts`."""
    points, normals = np.ascontiguousarray(query.points), np.ascontiguousarray(query.normals)
    patches = match.kept(OrientedPoints.patches_by, _ICP_EDGE_M)
    rules = _ICP_EDGE_M, reach, rounds, _FACING_ALIKE, _ROBUST_SHARE * reach, MIN_COUNTERPARTS
    return [aligned(np.ascontiguousarray(start), points, normals, patches, *rules) for start in starts]


def find_counterparts(moved: OrientedPoints, match: OrientedPoints, reach: float) -> Counterparts:
    """Each point of `moved` with the nearest one of `match`, where that is within `reach` metres and faces alike.

    This and `gauss_newton_step` are the plain form of a step of `iterate`, which is compiled.
    """
    gaps, nearest = match.tree.query(moved.points, distance_upper_bound=reach)
    found = np.flatnonzero(np.isfinite(gaps))
    facing = np.einsum("ij,ij->i", moved.normals[found], match.normals[nearest[found]])
    found = found[facing > _FACING_ALIKE]
    points, normals = moved.points[found], match.normals[nearest[found]]
    return Counterparts(points, np.einsum("ij,ij->i", points - match.points[nearest[found]], normals), normals)


def gauss_newton_step(pairs: Counterparts, reach: float) -> Array64:
    """The tangent (6,) in the match frame that brings the points onto the planes, large residuals weighing little."""
    weights = 1.0 / (1.0 + (pairs.residuals / (_ROBUST_SHARE * reach)) ** 2) ** 2
    jacobian = point_to_plane_jacobian(pairs.points, pairs.normals)
    weighted = jacobian * weights[:, None]
    hessian = weighted.T @ jacobian
    damping = _DAMPING * np.trace(hessian) / 6.0 * np.eye(6)
    return np.asarray(-np.linalg.solve(hessian + damping, weighted.T @ pairs.residuals))


def point_to_plane_jacobian(points: Array64, normals: Array64) -> Array64:
    """Derivatives (k, 6) of normal . (exp(tangent) point - anything) by the tangent, at zero."""
    return np.concatenate([normals, np.cross(points, normals)], axis=1)


def information(points: Array64, normals: Array64) -> Array64:
    """The information (6, 6) of a tangent of the pose from point-to-plane residuals of unit variance.

    The plain form of that of `contact_in_poses`.
    """
    jacobian = point_to_plane_jacobian(points, normals)
    return np.asarray(jacobian.T @ jacobian)


def observability(information: Array64, lever_m: float) -> float:
    """The share of the smallest eigenvalue of an information matrix (6, 6), with rotations measured at `lever_m`.

    Near 0 where the surfaces do not fix the pose (a corridor, a plane); at most 1/6.
    """
    scale = np.diag([1.0, 1.0, 1.0, *([1.0 / lever_m] * 3)])
    eigenvalues = np.linalg.eigvalsh(scale @ information @ scale)
    return float(max(eigenvalues[0], 0.0) / max(eigenvalues.sum(), 1e-12))
