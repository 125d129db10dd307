"""The overlap of two surfaces that does not depend on which points were kept of them (docs/decisions/0340).

A place keeps a point a cube where the sensor saw any surface, and of too many cubes those of least rank. Where a pose
lays the standpoints on each other, the same cubes were seen and kept of both, and much more touches there than in any
other pose, whatever the truth. Points that may touch only what lies in another cube are as many in one pose as in the
next.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.place_surface import CORNER
from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.verification.oriented_points import OrientedPoints, shared_shares

Array64 = NDArray[np.float64]

_MIXERS = np.array([0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D], dtype=np.int64)


def overlap_beside(
    T_match_query: se3.Matrix4, query: OrientedPoints, match: OrientedPoints, config: VerificationConfig
) -> float:
    """As `Evidence.overlap`, but no point may touch one in its own cube: for comparing poses alone, it is smaller."""
    sides = ((query, match, T_match_query), (match, query, se3.inverse(T_match_query)))
    return 0.5 * sum(_share_beside(one.standing.moved(T), other, config) for one, other, T in sides)


def _share_beside(standing: OrientedPoints, other: OrientedPoints, config: VerificationConfig) -> float:
    """The share of `standing` points that touch points of `other` in the opposite half of its cubes, in one frame."""
    is_odd = _is_odd(standing.points, config.spacing)
    even, odd = other.kept(_halves, config.spacing)
    asked = (standing.chosen(is_odd), even), (standing.chosen(~is_odd), odd)
    return 0.5 * sum(shared_shares(points, half, np.zeros((1, 3)), config)[0] for points, half in asked)


def _halves(surface: OrientedPoints, spacing: float) -> tuple[OrientedPoints, OrientedPoints]:
    """The points in even cubes and those in odd ones."""
    odd = _is_odd(surface.points, spacing)
    return surface.chosen(~odd), surface.chosen(odd)


def _is_odd(points: Array64, spacing: float) -> NDArray[np.bool_]:
    """Which points (n,) lie in odd cubes of edge `spacing`: every second one, as good as drawn at random."""
    mixed = np.floor(points / spacing + CORNER).astype(np.int64) @ _MIXERS
    return np.asarray(((mixed ^ (mixed >> 15) ^ (mixed >> 27)) & 1).astype(np.bool_))
