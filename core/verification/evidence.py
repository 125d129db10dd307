"""Evidence for and against an alignment: common surface, contrast with a shifted pose, free space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.kernels.seen_columns import in_seen_columns
from revisit.core.verification.line_of_sight import View, seen_through, view_of
from revisit.core.verification.oriented_points import COLUMN_M, OrientedPoints, contact, shared_shares
from revisit.core.verification.registration import Registration, information

Array64 = NDArray[np.float64]


@dataclass(frozen=True)
class Evidence:
    """What an alignment of two places is worth.

    overlap 0..1: the share of the standing surface in the region both have seen that lies on the other's surface, the
    mean of both directions. rmse_m: of the point-to-plane residuals of the points that do. information (6, 6): of the
    tangent (x, y, z, rx, ry, rz) in the match frame, of unit variance residuals. common: the smaller number of standing
    points in the shared region. contrast: how much of the overlap is lost when the query is moved along the horizontal
    direction that the surfaces fix least; near 0 where any place along a street or hedge would fit as well.
    seen_through 0..1: the share of what stands in either place, as far as the other has looked there, that the other
    has looked through. Contrast and seen_through have their worst values, 0 and 1, where the registration was given up,
    or where there is so little overlap that they would decide nothing.
    """

    overlap: float
    rmse_m: float
    information: Array64
    common: int
    contrast: float
    seen_through: float


def gather_evidence(
    registration: Registration, query: OrientedPoints, match: OrientedPoints, config: VerificationConfig
) -> Evidence:
    """All evidence about a registration; what costs time only where it was refined."""
    moved = query.moved(registration.T_match_query)
    forward = contact(moved, match, config)
    backward = contact(match.moved(se3.inverse(registration.T_match_query)), query, config)
    seen_query, seen_match = in_region(moved.standing, match), in_region(match.standing, moved)
    touching = forward.touching[: query.standing_count], backward.touching[: match.standing_count]
    fixed = information(moved.points[forward.touching], match.normals[forward.rows])
    residuals = forward.residuals
    overlap = 0.5 * (_share(touching[0], seen_query) + _share(touching[1], seen_match))
    promising = registration.refined and overlap >= config.min_overlap  # else it is rejected whatever they are
    return Evidence(
        overlap=overlap,
        rmse_m=float(np.sqrt(np.mean(residuals**2))) if len(residuals) else float(config.surface_distance),
        information=fixed,
        common=int(min(seen_query.sum(), seen_match.sum())),
        contrast=contrast(moved, match, weakest_direction(fixed), config) if promising else 0.0,
        seen_through=mutually_seen_through(registration.T_match_query, query, match, config) if promising else 1.0,
    )


def weakest_direction(information: Array64) -> Array64:
    """The horizontal unit direction (3,) along which an information matrix (6, 6) fixes the pose least."""
    return np.array([*np.linalg.eigh(information[:2, :2])[1][:, 0], 0.0])


def contrast(moved: OrientedPoints, match: OrientedPoints, direction: Array64, config: VerificationConfig) -> float:
    """The overlap of the standing query surface, less the largest one of it moved along `direction` (3,)."""
    shifts = [sign * shift for shift in config.contrast_shifts for sign in (-1.0, 1.0)]
    here, *aside = shared_shares(moved.standing, match, np.outer([0.0, *shifts], direction), config)
    return here - max(aside)


def mutually_seen_through(
    T_match_query: se3.Matrix4, query: OrientedPoints, match: OrientedPoints, config: VerificationConfig
) -> float:
    """The share of what stands in either place, where the other tells anything of it, that the other looked through."""
    views = query.kept(_view, config.sight_angle), match.kept(_view, config.sight_angle)
    of_query = seen_through(se3.apply(T_match_query, query.standing.points), views[1], config)
    of_match = seen_through(se3.apply(se3.inverse(T_match_query), match.standing.points), views[0], config)
    return (of_query[0] + of_match[0]) / max(of_query[1] + of_match[1], 1)


def in_region(surface: OrientedPoints, other: OrientedPoints) -> NDArray[np.bool_]:
    """Which points (n,) of a surface stand in a column in which the other place has seen anything."""
    return np.asarray(in_seen_columns(np.ascontiguousarray(surface.points), other.seen.slots, COLUMN_M))


def _view(surface: OrientedPoints, angle_deg: float) -> View:
    return view_of(surface.points, angle_deg)


def _share(hits: NDArray[np.bool_], of: NDArray[np.bool_]) -> float:
    return float((hits & of).sum()) / max(int(of.sum()), 1)
