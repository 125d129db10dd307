"""How distinct a place is within its map: at how many other spots its submap would pass (docs/decisions/0162)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.recognise.loops_beside import Beside

DISTINCTIVENESS = "distinctiveness"
"""The member of a loop's evidence that holds it."""

SPOT_M = 3.0
"""Poses of one query nearer to each other than this are one spot, where odometry has not drifted between them."""

_DRIFT = 0.01

Spot = tuple[NDArray[np.float64], int]
"""A position (3,) in the odometry frame of a drive, by the submap of that drive with this ordinal."""


def with_distinctiveness(loop: Beside, judged: Sequence[Beside], stride_m: float) -> LoopVerdict:
    """The verdict of `loop`, its evidence with `distinctiveness` where it is accepted or ambiguous."""
    if not loop.hypotheses:
        return loop.verdict
    told = distinctiveness(loop, judged, stride_m)
    return replace(loop.verdict, evidence={**loop.verdict.evidence, DISTINCTIVENESS: told})


def distinctiveness(loop: Beside, judged: Sequence[Beside], stride_m: float) -> dict[str, Any]:
    """What the candidates `judged` of a query say of `loop`, one of them, as JSON.

    compared: how many there were; passing: those that were accepted or are ambiguous; other_spots: at how many other
    spots of the drive that `loop` matches the query would stand by one of their poses. `stride_m` tells how far apart
    submaps of a drive are, and so how far odometry may have drifted between two of them.
    """
    passing = [one for one in judged if one.hypotheses]
    spots: list[Spot] = []
    for one in sorted(passing, key=lambda other: (other is not loop, -other.verdict.score)):
        if one.match.session_number == loop.match.session_number:
            for pose in one.hypotheses:
                stands = spot_of(one, pose)
                if not any(are_one(stands, spot, stride_m) for spot in spots):
                    spots.append(stands)
    return {"compared": len(judged), "passing": len(passing), "other_spots": max(len(spots) - 1, 0)}


def spot_of(loop: Beside, T_match_query: Matrix4) -> Spot:
    """Where the query of `loop` stands by a pose."""
    return (pose_matrix(loop.match.T_odom_submap) @ T_match_query)[:3, 3], loop.match.ordinal


def are_one(first: Spot, second: Spot, stride_m: float) -> bool:
    """Whether two spots of one drive are the same, as far as its odometry can tell."""
    drift_m = _DRIFT * stride_m * abs(first[1] - second[1])
    return float(np.linalg.norm(first[0] - second[0])) < SPOT_M + drift_m
