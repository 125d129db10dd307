"""How distinct a place is within its map: at how many other spots its submap would pass (docs/decisions/0161)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.acceptance.claim import Distinctiveness, LoopClaim
from revisit.core.geometry.se3 import Matrix4

SPOT_M = 3.0
"""Poses of one query nearer to each other than this are one spot, where odometry has not drifted between them."""

_DRIFT = 0.01

Spot = tuple[NDArray[np.float64], int]
"""A position (3,) in the odometry frame of a drive, by the submap of that drive with this ordinal."""


def with_distinctiveness(claims: Sequence[LoopClaim], stride_m: float) -> list[LoopClaim]:
    """The claims of one query, those that say a pose with how distinct it is.

    `stride_m` tells how far apart submaps of a drive are, and so how far odometry may have drifted between two of them.
    """
    return [
        replace(one, distinctiveness=_distinctiveness(one, claims, stride_m)) if one.hypotheses else one
        for one in claims
    ]


def _distinctiveness(claim: LoopClaim, claims: Sequence[LoopClaim], stride_m: float) -> Distinctiveness:
    passing = [one for one in claims if one.hypotheses]
    spots: list[Spot] = []
    for one in sorted(passing, key=lambda other: (other is not claim, -other.score)):
        if one.match.drive == claim.match.drive:
            for pose in one.hypotheses:
                stands = spot_of(one, pose)
                if not any(are_one(stands, spot, stride_m) for spot in spots):
                    spots.append(stands)
    return Distinctiveness(len(claims), len(passing), max(len(spots) - 1, 0))


def spot_of(claim: LoopClaim, T_match_query: Matrix4) -> Spot:
    """Where the query of a claim stands by a pose."""
    return (claim.match.T_odom_submap @ T_match_query)[:3, 3], claim.match.ordinal


def are_one(first: Spot, second: Spot, stride_m: float) -> bool:
    """Whether two spots of one drive are the same, as far as its odometry can tell."""
    drift_m = _DRIFT * stride_m * abs(first[1] - second[1])
    return float(np.linalg.norm(first[0] - second[0])) < SPOT_M + drift_m
