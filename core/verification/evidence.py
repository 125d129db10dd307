"""Evidence for and against an alignment: common surface, contrast with a shifted pose, free space."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.verification.line_of_sight import View, seen_through, view_of
from revisit.core.verification.oriented_points import OrientedPoints, contact_in_poses, shared_shares
from revisit.core.verification.registration import Registration

Array64 = NDArray[np.float64]

_FEW = 5  # every so many-th point tells about how much a move loses
_SURE_DEVIATIONS = 2.0  # standard deviations of a share of half of these points, the widest there is


@dataclass(frozen=True)
class Evidence:
    """The evidence of an alignment of two places.

    overlap 0..1: the share of the standing surface in the region both have seen that lies on the other's surface, the
    mean of both directions. rmse_m: of the point-to-plane residuals of the points that do. information (6, 6): of the
    tangent (x, y, z, rx, ry, rz) in the match frame, of unit variance residuals. common: the smaller number of standing
    points in the shared region. contrast: how much of the overlap is lost when the query is moved along the horizontal
    direction that the surfaces fix least; near 0 where any place along a street or hedge would fit as well.
    seen_through 0..1: the share of structure in either place, as far as the other has looked there, that the other
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
    """All evidence about a registration; the costly parts only where it was refined."""
    T_match_query = registration.T_match_query
    directions = (T_match_query, query, match), (se3.inverse(T_match_query), match, query)
    forward, backward = contact_in_poses(directions, config)
    overlap = 0.5 * (forward.share + backward.share)
    found = Evidence(
        overlap=overlap,
        rmse_m=float(np.sqrt(forward.squares / forward.touching)) if forward.touching else config.surface_distance,
        information=forward.information,
        common=min(forward.standing, backward.standing),
        contrast=0.0,
        seen_through=1.0,
    )
    if not registration.refined or overlap < config.min_overlap:  # then it is rejected anyway
        return found
    standing = query.standing.moved(T_match_query)
    return replace(
        found,
        contrast=contrast(standing, match, weakest_direction(forward.information), forward.share, config),
        seen_through=mutually_seen_through(T_match_query, query, match, config),
    )


def weakest_direction(information: Array64) -> Array64:
    """The horizontal unit direction (3,) along which an information matrix (6, 6) fixes the pose least."""
    return np.array([*np.linalg.eigh(information[:2, :2])[1][:, 0], 0.0])


def contrast(
    standing: OrientedPoints, match: OrientedPoints, direction: Array64, here: float, config: VerificationConfig
) -> float:
    """The overlap `here` of the standing query surface, less the largest one of it moved along `direction` (3,).

    Every few points tell which moves may have the largest overlap; only for these all of them are asked.
    """
    shifts = np.outer([sign * shift for shift in config.contrast_shifts for sign in (-1.0, 1.0)], direction)
    few = standing.thinned(_FEW)
    about = np.array(shared_shares(few, match, shifts, config))
    likely = about >= about.max() - _SURE_DEVIATIONS * 0.5 / np.sqrt(max(len(few.points), 1))
    return here - max(shared_shares(standing, match, shifts[likely], config))


def mutually_seen_through(
    T_match_query: se3.Matrix4, query: OrientedPoints, match: OrientedPoints, config: VerificationConfig
) -> float:
    """The share of either place, as far as the other tells of it, that the other looked through."""
    views = query.kept(_view, config.sight_angle), match.kept(_view, config.sight_angle)
    of_query = seen_through(query.standing.points, T_match_query, views[1], config)
    of_match = seen_through(match.standing.points, se3.inverse(T_match_query), views[0], config)
    return (of_query[0] + of_match[0]) / max(of_query[1] + of_match[1], 1)


def _view(surface: OrientedPoints, angle_deg: float) -> View:
    return view_of(surface.points, angle_deg)
